#!/usr/bin/env bash
# Pin everything: resolve the *.in files and write the *.txt files: ./koop shell requirements/lock.sh.
#
# One resolution of all the files together, for the oldest supported Python, so that 3.10 to 3.13 get the very same
# versions. `koop` installs the result with --no-deps: what isn't listed isn't installed.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"

all=$(mktemp)
trap 'rm -f "$all"' EXIT

compile() {  # compile OUTPUT uv-arguments...
  local output=$1
  shift
  UV_CUSTOM_COMPILE_COMMAND=requirements/lock.sh uv pip compile --quiet --no-annotate --no-emit-index-url \
    --no-emit-find-links --python-version 3.10 --python-platform x86_64-manylinux_2_28 --upgrade \
    --output-file "$output" "$@"
}

compile "$all" ros-jazzy.in python.in hil.in plants.in store.in
compile ros-jazzy.txt --constraints "$all" ros-jazzy.in
compile ros-kilted.txt --constraints <(grep -v ^ros- "$all") ros-kilted.in
compile hil.txt --constraints "$all" hil.in
# NumPy comes with python.txt or an installed ROS 2.
compile plants.txt --constraints "$all" --no-emit-package numpy plants.in
compile store.txt --constraints "$all" store.in
compile docs.txt docs.in
# An installed ROS 2 brings these three, and its binaries want the versions they were built with. On the wheels they
# come with ros-*.txt.
# colcon asks for coverage and pytest-cov, and needs them for `colcon test --pytest-with-coverage` only; where coverage is
# installed, numba imports it in every node and every command: 0.07 s of a processor each time.
compile python.txt --constraints "$all" \
  --no-emit-package numpy --no-emit-package empy --no-emit-package lark-parser \
  --no-emit-package coverage --no-emit-package pytest-cov python.in
