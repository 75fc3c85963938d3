#!/usr/bin/env bash
# Builds the Python package into a fresh virtual environment and plays its tests. Skips where there
# is no Python with `venv`, or where PyPI cannot be reached.
set -euo pipefail
cd "$(dirname "$0")/../.."

env="$(mktemp -d)"
trap 'rm -rf "$env"' EXIT
if ! python3 -m venv "$env" 2>/dev/null || ! "$env/bin/pip" -q install 'maturin>=1.9,<2' 2>/dev/null; then
  echo "skipped: no Python with venv, or no PyPI"
  exit 0
fi
"$env/bin/pip" -q install './python[test]' pyright
"$env/bin/python" -c "
import eisbench as eb
print(eb.fit_erm(eb.read_spectra('fixtures/data/spectra/p45b_thesis.csv'), rc=4, pool=True))"
cd python
"$env/bin/pyright" --pythonpath "$env/bin/python"
"$env/bin/python" -m pytest -q
