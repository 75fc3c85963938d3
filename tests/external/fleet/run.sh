#!/bin/sh
# A fleet of real servers with their agents on one NATS server, with everything that breaks: the
# broker is killed, servers and agents are killed with SIGKILL, and the network to a third of them is
# cut. Counts afterwards, from
# the run folders on disk alone, how often each job was run. Needs nats-server and Python from 3.10 on.
#
#     tests/external/fleet/run.sh --serves 20 --benches 10 --jobs 2000
#
# EIS_BENCH and EIS_FLEET name other programs than those of the last build.
set -eu
here="$(cd "$(dirname "$0")" && pwd)"
if ! command -v nats-server > /dev/null; then
  echo "skipped: there is no nats-server on the path"
  exit 0
fi
built="$here/../../../target/debug"
exec python3 "$here/drill.py" --program "${EIS_BENCH:-$built/eis-bench}" \
  --fleet-program "${EIS_FLEET:-$built/eis-fleet}" "$@"
