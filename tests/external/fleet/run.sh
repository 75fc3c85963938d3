#!/bin/sh
# A fleet of real servers on one NATS server, with everything that breaks: the broker is killed,
# servers are killed with SIGKILL, and the network to a third of them is cut. Counts afterwards, from
# the run folders on disk alone, how often each job was run. Needs nats-server and Python from 3.10 on.
#
#     tests/external/fleet/run.sh --serves 20 --benches 10 --jobs 2000
#
# EIS_BENCH names another program than that of the last build.
set -eu
here="$(cd "$(dirname "$0")" && pwd)"
if ! command -v nats-server > /dev/null; then
  echo "skipped: there is no nats-server on the path"
  exit 0
fi
exec python3 "$here/drill.py" --program "${EIS_BENCH:-$here/../../../target/debug/eis-bench}" "$@"
