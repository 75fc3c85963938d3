#!/usr/bin/env bash
# 100 000 spectra on the cores of this machine and on a Ray cluster of two nodes on it, one of which is
# killed in the middle; all tables must be the same to the last bit. Skips where the package or Ray is
# not installed. Another number of spectra is the first argument.
set -euo pipefail
cd "$(dirname "$0")"

python="${PYTHON:-python3}"
if ! "$python" -c 'import eisbench, ray, ray.data, pyarrow' 2>/dev/null; then
  echo "skipped: needs Python with eisbench, ray[data] and pyarrow ('pip install ./python ray[data] pyarrow')"
  exit 0
fi
folder="$(mktemp -d)"
trap 'rm -rf "$folder"' EXIT
# Ray tells the death of the node at length.
"$python" run.py "$folder/job" --spectra "${1:-100000}" 2>"$folder/log" |
  grep '^[0-9]* spectra\|^local\|^Ray\|^without\|^the same' || {
  tail -20 "$folder/log"
  exit 1
}
