#!/usr/bin/env bash
# A property-based tester (schemathesis) against the API's own OpenAPI document, bounded: no 5xx, no
# undocumented answer, no wrongly opened door. Says why it is skipped where Python, curl or the
# package cannot be had.
#
#   tests/external/api/run.sh [EIS_BENCH [EXAMPLES]]
#     EIS_BENCH  the program [default: target/debug/eis-bench]
#     EXAMPLES   examples per operation [default: 20]
#
# With EXTERNAL_API_SCHEMATHESIS set, that program is taken.
set -euo pipefail
root="$(cd "$(dirname "$0")/../../.." && pwd)"
target="${CARGO_TARGET_DIR:-$root/target}"
program="${1:-$target/debug/eis-bench}"
examples="${2:-20}"

skip() { printf 'property-based tester: skipped: %s\n' "$*"; exit 0; }

[ -x "$program" ] || skip "no program at $program: build it first"
program="$(cd "$(dirname "$program")" && pwd)/$(basename "$program")"
command -v curl >/dev/null || skip "no curl"
tester="${EXTERNAL_API_SCHEMATHESIS:-}"
if [ -z "$tester" ]; then
  command -v python3 >/dev/null || skip "no python3"
  venv="$target/external-api"
  if [ ! -f "$venv/installed" ]; then
    python3 -m venv "$venv" >/dev/null 2>&1 || skip "no venv"
    timeout 300 "$venv/bin/pip" install -q "schemathesis==4.*" >/dev/null 2>&1 || skip "schemathesis cannot be had"
    touch "$venv/installed"
  fi
  tester="$venv/bin/schemathesis"
fi

work="$(mktemp -d)"
server=""
ended() {
  if [ -n "$server" ]; then kill "$server" 2>/dev/null || true; wait "$server" 2>/dev/null || true; fi
  rm -rf "$work"
}
trap ended EXIT

cp -r "$root/configs" "$work/configs"
# The built-in simulated bench; what the tester submits waits, for the queue is held, and nothing is
# limited but the size.
cat > "$work/serve.toml" <<'TOML'
listen = "127.0.0.1:0"
data = "data"
configs = "configs"
benches = ["configs/benches/demo.toml"]
[limits]
requests_per_s = 100000
burst = 1000000
TOML
token="$("$program" token add "$work/serve.toml" tester --scope read,operate,energise,clear-trip 2>/dev/null)"
"$program" serve "$work/serve.toml" > "$work/said" 2> "$work/errors" &
server=$!
for _ in $(seq 600); do grep -q listening "$work/said" && break; sleep 0.1; done
url="$(sed -n 's/^listening on //p' "$work/said")"
[ -n "$url" ] || { echo "the server does not listen:"; cat "$work/errors"; exit 1; }
auth="Authorization: Bearer $token"
api() { curl -sf --max-time 60 -H "$auth" -H 'Content-Type: application/json' "$@"; }

# One run, so that there is something to look at; then the queue is held.
api -d '{"experiment":"demo"}' "$url/api/v1/queue" > /dev/null
done_=""
for _ in $(seq 600); do api "$url/api/v1/runs" | grep -q '"finished":true' && { done_=yes; break; }; sleep 1; done
[ -n "$done_" ] || { echo "the demo did not complete"; cat "$work/errors"; exit 1; }
api -d '{"why":"tested"}' "$url/api/v1/benches/demo/hold" > /dev/null

# With names that are there, then with any. The event stream has no end and is left to our own
# tests; `release` would let the queue go.
printf '[parameters]\nbench = "demo"\nrun = "demo-1"\nexperiment = "demo"\n' > "$work/named.toml"
printf '' > "$work/any.toml"
checks=not_a_server_error,status_code_conformance,content_type_conformance
checks+=,response_schema_conformance,negative_data_rejection
failed=0
cd "$work"
for names in named any; do
  printf -- '-- names: %s\n' "$names"
  NO_COLOR=1 timeout 1800 "$tester" --config-file "$work/$names.toml" run "$url/api/v1/openapi.json" \
    --header "$auth" --max-examples "$examples" --workers 2 --seed 1 --request-timeout 60 \
    --exclude-path /api/v1/events --exclude-path-regex '/release$' --phases coverage,fuzzing,stateful \
    --checks "$checks,unsupported_method,allow_header_conformance" > "$work/$names.log" 2>&1 || failed=1
  # Its list of what was found wrong, where there is one, and its summary.
  sed -n '/= FAILURES =/,$p; /= SUMMARY =/,$p' "$work/$names.log" | awk '!seen[$0]++ || NF' | tail -n 80
done
kill -0 "$server" 2>/dev/null || { echo "the server has ended:"; tail -n 20 "$work/errors"; exit 1; }
if grep -q panicked "$work/errors"; then grep panicked "$work/errors"; exit 1; fi
exit "$failed"
