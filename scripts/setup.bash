# shellcheck shell=bash
# The set-up, sourced by koop when something is missing or stale: system packages, .venv, the built workspace.
#
# Each part writes its stamp last, so a set-up that was interrupted goes on where it stopped. UNDERLAY and the functions
# say, die, venv_key, ws_key, ... are koop's.

LOG=$WS/log/koop-setup.log
VENV_ORIGIN=$VENV/koop.origin
PYTHONS=(python3.12 python3.11 python3.13 python3.10 python3)

set_up_what_is_missing() {
  mkdir -p "$WS/log" || die 1 "can't write to $WS"
  # The lock is held on this script itself, so no file is left over. It ends with the process, however that ends.
  exec 9<"$ROOT/scripts/setup.bash"
  if ! flock --nonblock 9; then
    say "another set-up is running, waiting for it"
    flock 9
  fi
  : >"$LOG"
  [[ $UNDERLAY == wheels ]] || check_underlay
  # Another call may have done it while this one waited.
  venv_is_fresh || set_up_venv
  ws_is_fresh || set_up_workspace
  exec 9<&-
}

# step LABEL COMMAND...: run it with its output in the log; on failure show the end of that and exit.
step() {
  local label=$1 start=$SECONDS code
  shift
  printf 'koop: %s ... ' "$label" >&2
  printf '\n== %s\n' "$label" >>"$LOG"
  set +e  # `if ! ...` would switch it off inside the command too
  (set -e; "$@") >>"$LOG" 2>&1
  code=$?
  set -e
  if ((code)); then
    echo >&2
    say "failed: $label. The last lines:"
    tail -n 25 "$LOG" | sed 's/^/  | /' >&2
    die 1 "the whole log: $LOG"
  fi
  printf '%s s\n' "$((SECONDS - start))" >&2
}

# --- interpreter and system packages ----------------------------------------------------------------------------------

# Print "X.Y VENV HEADERS" (1 or 0 each) of a Python that can be used. Run, not just looked up: a pyenv shim exists for
# versions that aren't active.
probe() {
  "$1" - <<'EOF' 2>/dev/null
import importlib.util
import os
import sys
import sysconfig

if not (3, 10) <= sys.version_info[:2] <= (3, 13) or sys.implementation.name != "cpython":
    sys.exit(1)
venv = all(importlib.util.find_spec(name) for name in ("venv", "ensurepip"))
headers = os.path.exists(os.path.join(sysconfig.get_path("include"), "Python.h"))
print("%d.%d" % sys.version_info[:2], int(venv), int(headers))
EOF
}

# Set PYTHON and PYTHON_HAS: KOOP_PYTHON, else that of .venv, else the first that lacks nothing, else the first that works
# at all.
choose_python() {
  local candidate found candidates=("${PYTHONS[@]}")
  if found=$("$VENV/bin/python" -c 'import sys; print(sys._base_executable)' 2>/dev/null); then
    candidates=("$found" "${candidates[@]}")
  fi
  PYTHON='' PYTHON_HAS=''
  if [[ -n ${KOOP_PYTHON:-} ]]; then
    candidates=("$KOOP_PYTHON")
    probe "$KOOP_PYTHON" >/dev/null || die 4 "KOOP_PYTHON=$KOOP_PYTHON is not a Python 3.10 to 3.13"
  fi
  for candidate in "${candidates[@]}"; do
    found=$(probe "$candidate") || continue
    [[ $UNDERLAY == wheels ]] || "$candidate" -c 'import rclpy' 2>/dev/null || continue
    if [[ $found == *' 1 1' || -z $PYTHON ]]; then
      PYTHON=$(command -v "$candidate") PYTHON_HAS=$found
    fi
    [[ $found != *' 1 1' ]] || break
  done
}

# Fall back on the wheels where no Python can import the sourced ROS 2, and remember that.
check_underlay() {
  choose_python
  [[ -z $PYTHON ]] || return 0
  say "a ROS 2 ${DISTRO^} is sourced, but no Python here can import its rclpy: the ${DISTRO^} wheels are used"
  printf '%s' "$UNDERLAY" >"$REFUSED"
  UNDERLAY=wheels
  clean_environment
}

# Print the Debian packages that are missing for PYTHON and a compiler.
missing_packages() {
  local version has_venv has_headers
  read -r version has_venv has_headers <<<"$PYTHON_HAS"
  if [[ -z $PYTHON ]]; then
    echo python3 python3-venv python3-dev
  else
    # The interpreter's own packages: python3-venv belongs to the system's default version only.
    ((has_venv)) || echo "python$version-venv"
    ((has_headers)) || echo "python$version-dev"
  fi
  # CMake takes CC and CXX where they are set.
  [[ -n ${CXX:-} ]] || command -v c++ g++ clang++ >/dev/null || echo g++
  [[ -n ${CC:-} ]] || command -v cc gcc clang >/dev/null || echo gcc
}

apt_install() {
  "$@" apt-get update
  "$@" env DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends "${packages[@]}"
}

# Install the Debian packages given, or say how and exit.
install_packages() {
  local packages=("$@")
  if ! command -v apt-get >/dev/null; then
    die 3 "missing: ${packages[*]} (Debian's names). Install them with this system's package manager and try again."
  elif (($(id -u) == 0)); then
    step "Installing ${packages[*]}" apt_install
  elif sudo -n true 2>/dev/null; then
    step "Installing ${packages[*]} with sudo" apt_install sudo -n
  else
    say "system packages are missing and installing them needs root. Run this and try again:"
    printf '  sudo apt-get update && sudo apt-get install -y --no-install-recommends %s\n' "${packages[*]}" >&2
    exit 3
  fi
  hash -r
}

ensure_system_packages() {
  local packages
  read -ra packages <<<"$(missing_packages | tr '\n' ' ')"
  ((${#packages[@]} == 0)) || install_packages "${packages[@]}"
}

# Get a browser for the tests. Without one they are skipped, which continuous integration doesn't accept.
get_browser() {
  local code
  mkdir -p "$WS/log"
  set +e
  (install_browser)
  code=$?
  set -e
  hash -r
  ((code)) || return 0
  [[ -z ${CI:-} ]] || exit "$code"
  say "no Chromium: the tests that need one are skipped"
}

install_browser() {
  # A snap sees neither /tmp nor hidden folders, where the tests' pages are.
  ! grep -qs '^ID=ubuntu$' /etc/os-release ||
    die 3 "no Chromium for the browser tests, and Ubuntu's is a snap, which can't open their files: install Google Chrome"
  install_packages chromium
}

# The plants of others that tests run, and the object store. Without them those are skipped, which continuous integration doesn't accept.
install_plants() {
  local code
  mkdir -p "$WS/log"
  set +e
  (step "Installing the plants and the object store of the tests" \
    install_python -r "$ROOT/requirements/plants.txt" -r "$ROOT/requirements/store.txt")
  code=$?
  set -e
  if ((code)); then
    [[ -z ${CI:-} ]] || exit "$code"
    say "the tests that fly an aircraft, run an FMU or read from an object store are skipped"
  else
    plants_key >"$VENV/koop.plants"
  fi
}

# --- .venv ------------------------------------------------------------------------------------------------------------

# An environment of the same place, ROS 2 and interpreter is kept: pip then installs only what differs, be it after a
# set-up that was interrupted or because of new pins.
venv_origin() { venv_place; python_id "$PYTHON"; sha256sum <"$ROOT/requirements/ros-$DISTRO.txt"; }
venv_is_of_same_origin() {
  [[ -f $VENV_ORIGIN && $(<"$VENV_ORIGIN") == "$(venv_origin)" ]] && "$VENV/bin/python" -m pip --version &>/dev/null
}

# Print "PID COMMAND" of every process that has a file of these folders mapped: a node, however it was started, an
# interpreter, a compiler. A lock would not know of a `ros2 launch` or an editor, which never come past ./koop.
users_of() {
  local file pid
  # shellcheck disable=SC2062
  for file in $(readlink -f "$@" | sed 's#$#/#' | grep -lsFf - /proc/[0-9]*/maps); do
    pid=${file//[!0-9]/}
    printf '%8d  %s\n' "$pid" "$(tr '\0' ' ' <"/proc/$pid/cmdline" | sed 's/ $//')"
  done 2>/dev/null
}

# What runs from these folders would lose the modules that it has yet to load.
refuse_while_in_use() {
  local users
  users=$(users_of "$@")
  [[ -n $users ]] || return 0
  say "the environment would have to be replaced, but is in use by"
  printf '%s\n' "$users" >&2
  die 5 "end these processes and try again"
}

set_up_venv() {
  [[ $(uname -sm) == 'Linux x86_64' ]] || die 4 "the ROS 2 wheels are for Linux on x86-64, this is $(uname -sm)"
  [[ -z $OTHER_DISTRO ]] || say "ROS 2 $OTHER_DISTRO is sourced, not $DISTRO: it is left aside, the ${DISTRO^} wheels are used"
  choose_python
  ensure_system_packages
  [[ -n $PYTHON ]] || choose_python
  [[ -n $PYTHON ]] || die 4 "no Python 3.10 to 3.13 found; name one with KOOP_PYTHON=/path/to/python"

  refuse_while_in_use "$VENV" "$WS/build"
  rm -f "$VENV_STAMP" "$ENV_FILE"
  if ! venv_is_of_same_origin; then
    rm -f "$WS_STAMP"
    say "the first call sets up .venv (1.2 GB) and the workspace, which takes a minute or two; the first run then compiles for 10 to 50 s"
    local options=(--clear)
    [[ $UNDERLAY == wheels ]] || options+=(--system-site-packages)
    step "Creating .venv with $PYTHON (${PYTHON_HAS%% *})" "$PYTHON" -m venv "${options[@]}" "$VENV"
    venv_origin >"$VENV_ORIGIN"
  fi

  local files=(-r "$ROOT/requirements/python.txt" -r "$ROOT/requirements/hil.txt")
  [[ $UNDERLAY != wheels ]] || files+=(-r "$ROOT/requirements/ros-$DISTRO.txt")
  step "Installing Python packages$([[ $UNDERLAY != wheels ]] || echo ' and ROS 2 wheels')" install_python "${files[@]}"
  [[ $UNDERLAY != wheels ]] || step "Setting the include paths of the ROS 2 wheels" fix_include_paths
  venv_key >"$VENV_STAMP.new"
  mv "$VENV_STAMP.new" "$VENV_STAMP"
}

# Install requirements. uv takes a third of pip's time; it does not read pip's configuration, so pip installs where that
# names an index, and where uv fails. Complete lock files: --no-deps makes sure that nothing else comes in.
install_python() {
  local python=$VENV/bin/python
  local pip=("$python" -m pip install --disable-pip-version-check --no-deps)
  if ! "$python" -m pip config list | grep index && "${pip[@]}" "$(grep '^uv==' "$ROOT/requirements/python.txt")" &&
    "$python" -m uv pip install --python "$python" --system-certs --no-deps "$@"; then
    return
  fi
  "${pip[@]}" "$@"
}

# The wheels' exported CMake files name the include folders of the machine that built them (/opt/python/cp311-...).
fix_include_paths() {
  local python numpy
  python=$("$VENV/bin/python" -c 'import sysconfig; print(sysconfig.get_path("include"))')
  numpy=$("$VENV/bin/python" -c 'import numpy; print(numpy.get_include())')
  { grep -rlZ --include='*.cmake' '/opt/python/' "$VENV/share" "$VENV/lib/cmake" || true; } |
    xargs -0 --no-run-if-empty sed -i -E \
      -e "s#/opt/python/[^;\"]*/numpy/_?core/include#$numpy#g" \
      -e "s#/opt/python/[^;\"]*/include/python3\.[0-9]+#$python#g"
}

# --- workspace --------------------------------------------------------------------------------------------------------

set_up_workspace() {
  local key package changed=() known
  key=$(ws_key)
  known=$(cat "$WS_STAMP" 2>/dev/null || true)
  if [[ -z $known ]]; then  # what is there is of another environment, or half-made
    # A compiler that outlived a killed build may still be writing for a moment.
    rm -rf "$WS/build" "$WS/install" 2>/dev/null || { sleep 5 && rm -rf "$WS/build" "$WS/install"; }
  fi
  # A line of a key is "HASH  ./PKG/FILE"; those only in one of the two belong to packages that changed.
  for package in $(LC_ALL=C comm -3 <(LC_ALL=C sort <<<"$known") <(LC_ALL=C sort <<<"$key") |
    sed -nE 's#^\t?[0-9a-f]+  \./([^/]+)/.*#\1#p' | sort -u); do
    if [[ -f $ROOT/src/$package/package.xml ]]; then
      changed+=("$package")
    else
      rm -rf "$WS/build/$package" "$WS/install/$package"
    fi
  done
  for package in "${changed[@]}"; do  # a library that is rebuilt under a node takes it down
    [[ ! -f $ROOT/src/$package/CMakeLists.txt ]] || refuse_while_in_use "$WS/build/$package"
  done
  rm -f "$ENV_FILE"
  ((${#changed[@]} == 0)) || step "Building ${#changed[@]} package(s) of the workspace" build "${changed[@]}"
  step "Working out the environment" write_env_file
  printf '%s\n' "$key" >"$WS_STAMP.new"
  mv "$WS_STAMP.new" "$WS_STAMP"
}

# What the underlay gives, before the workspace.
enter_underlay() {
  export PATH=$VENV/bin:$PATH VIRTUAL_ENV=$VENV
  [[ $UNDERLAY == wheels ]] || return 0
  export ROS_DISTRO=$DISTRO ROS_VERSION=2 ROS_PYTHON_VERSION=3
  export AMENT_PREFIX_PATH=$VENV CMAKE_PREFIX_PATH=$VENV
  # The wheels' bootstrapper would set this and start every Python a second time; the mark tells it that it's done.
  local folder
  LD_LIBRARY_PATH=$VENV/lib
  for folder in "$VENV"/lib/python3.*/site-packages/ros_*.libs; do
    [[ ! -d $folder ]] || LD_LIBRARY_PATH+=:$folder
  done
  export LD_LIBRARY_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE=1
}

build() (
  enter_underlay
  cd "$WS" || exit
  # setuptools warns about the very commands that colcon drives it with.
  export PYTHONWARNINGS=ignore
  # A thread of colcon's writes the logs, while build.py may be in the folder of a package.
  export COLCON_LOG_PATH=$WS/log
  # Without this, colcon lets a machine that is busy build one file at a time.
  MAKEFLAGS=-j$(nproc)
  export MAKEFLAGS
  python "$ROOT/scripts/build.py" build --symlink-install --packages-select "$@" --event-handlers console_cohesion+ \
    --cmake-args -G Ninja -DBUILD_TESTING=OFF "-DPython3_EXECUTABLE=$VENV/bin/python"
)

# Print a path list without the folders in which setuptools has left nothing but a link to a package's sources. Colcon
# lists those, too, and in 18 folders more every import would be looked for in vain.
without_links() {
  local entry kept=
  local IFS=:
  for entry in $1; do
    compgen -G "$entry/*.egg-link" >/dev/null || kept+=:$entry
  done
  printf '%s' "${kept#:}"
}

# Source the workspace once and keep what that sets: its own script takes a second each time. Path lists are kept as what
# comes in front of the caller's.
write_env_file() (
  declare -A outer
  unset COLCON_PREFIX_PATH
  for name in "${PATH_LISTS[@]}"; do outer[$name]=${!name:-}; done
  enter_underlay
  set +u  # colcon's scripts read unset variables
  # shellcheck source=/dev/null
  source "$WS/install/local_setup.bash"
  set -u
  {
    for name in "${PATH_LISTS[@]}"; do
      added=${!name:-}
      added=${added%"${outer[$name]}"}
      [[ $name != PYTHONPATH ]] || added=$(without_links "$added")
      # shellcheck disable=SC2016
      [[ -z $added ]] || printf 'export %s=%q"${%s:+:$%s}"\n' "$name" "${added%:}" "$name" "$name"
    done
    for name in ROS_DISTRO ROS_VERSION ROS_PYTHON_VERSION _ROS_WHEELS_BOOTSTRAP_COMPLETE; do
      [[ -z ${!name:-} ]] || printf 'export %s=%q\n' "$name" "${!name}"
    done
  } >"$ENV_FILE.new"
  mv "$ENV_FILE.new" "$ENV_FILE"
)
