#!/usr/bin/env bash
# Measure which lines and branches of each package the suite runs, nodes included: scripts/coverage.bash [PYTEST ARGUMENTS]
#
# What runs compiled is left out, for coverage can't see into it. coverage is there for the time of the measurement
# only: where it's installed, numba imports it in every process.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

export COVERAGE_PROCESS_START=$PWD/pyproject.toml COVERAGE_FILE=$PWD/.coverage_data/data
python=$PWD/.venv/bin/python
rm -rf .coverage_data
mkdir .coverage_data
./koop setup
trap '"$python" -m uv pip uninstall --quiet --python "$python" coverage' EXIT
"$python" -m uv pip install --quiet --system-certs --python "$python" 'coverage==7.*'

failed=0
./koop test "$@" || failed=$?
unset COVERAGE_PROCESS_START
"$python" -m coverage combine --quiet .coverage_data
rm -f .coverage_data/data.*  # torn, of processes that tests kill
for package in src/*/; do
  name=$(basename "$package")
  [[ -d $package$name ]] || continue  # messages alone
  printf '%-18s %s %%\n' "$name" "$("$python" -m coverage report --include="$package*" --format=total)"
done
printf '%-18s %s %%\n' all "$("$python" -m coverage report --format=total)"
exit "$failed"
