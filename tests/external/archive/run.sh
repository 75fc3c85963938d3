#!/usr/bin/env bash
# The archive against an S3-compatible server that others wrote (moto), through a proxy that fails and
# with processes that are killed; every byte is compared by a reader that is not ours (boto3, hashlib),
# and the tables are read with pyarrow, polars, DuckDB and PySpark. Optional: where Python or PyPI is
# not there it says so and ends well. PySpark is left out where there is no Java.
#
#   tests/external/archive/run.sh [EIS_BENCH [RUNS [KILLS]]]
#     EIS_BENCH  the program [default: target/debug/eis-bench]
#     RUNS       run folders [default: 1000]
#     KILLS      processes that are killed [default: 10]
#
# With EXTERNAL_ARCHIVE_PYTHON set, that Python is taken.
set -euo pipefail
root="$(cd "$(dirname "$0")/../../.." && pwd)"
target="${CARGO_TARGET_DIR:-$root/target}"
program="${1:-$target/debug/eis-bench}"

skip() { printf 'archive: skipped: %s\n' "$*"; exit 0; }

[ -x "$program" ] || skip "no program at $program: build it first"
python="${EXTERNAL_ARCHIVE_PYTHON:-}"
if [ -z "$python" ]; then
  command -v python3 >/dev/null || skip "no python3"
  venv="$target/external-archive"
  if [ ! -f "$venv/installed" ]; then
    python3 -m venv "$venv" >/dev/null 2>&1 || skip "no venv"
    timeout 600 "$venv/bin/pip" install -q -r "$root/tests/external/archive/requirements.txt" \
      >/dev/null 2>&1 || skip "the packages cannot be had"
    touch "$venv/installed"
  fi
  python="$venv/bin/python"
fi
exec "$python" "$root/tests/external/archive/drill.py" "$program" "$root" "${2:-1000}" "${3:-10}"
