#!/usr/bin/env bash
# A property-based tester (schemathesis) against the API's own OpenAPI document, bounded: no 5xx, no undocumented answer, no wrongly opened door.
# Needs Python and the package index; the environment is made outside the tree. `tests/external/api/run.sh [EXAMPLES per operation, 40]`
set -euo pipefail
cd "$(dirname "$0")/../../.."

examples="${1:-40}"
venv="${EIS_BENCH_VENV:-${XDG_CACHE_HOME:-$HOME/.cache}/eis-bench/schemathesis}"
[ -x "$venv/bin/schemathesis" ] || { python3 -m venv "$venv" && "$venv/bin/pip" install --quiet "schemathesis==4.*"; }

cargo build --locked --quiet -p bench-daemon
bin="${CARGO_TARGET_DIR:-target}/debug/eis-bench"
work="$(mktemp -d)"
trap 'kill "$server" 2>/dev/null; wait "$server" 2>/dev/null; rm -rf "$work"' EXIT

cp -r configs "$work/configs"
# The built-in simulated bench; what the tester submits waits, for the queue is held, and nothing is limited but the size.
cat > "$work/serve.toml" <<'TOML'
listen = "127.0.0.1:0"
data = "data"
configs = "configs"
benches = ["configs/benches/demo.toml"]
[limits]
requests_per_s = 100000
burst = 1000000
TOML
"$bin" token add "$work/serve.toml" tester --scope read,operate,energise,clear-trip > "$work/token" 2>/dev/null
"$bin" serve "$work/serve.toml" > "$work/said" 2> "$work/errors" &
server=$!
for _ in $(seq 100); do grep -q listening "$work/said" && break; sleep 0.1; done
url="$(sed -n 's/^listening on //p' "$work/said")"
token="$(cat "$work/token")"
auth="Authorization: Bearer $token"

# One run, so that there is something to look at; then the queue is held.
curl -sf -H "$auth" -H 'Content-Type: application/json' -d '{"experiment":"demo"}' "$url/api/v1/queue" > /dev/null
for _ in $(seq 300); do curl -sf -H "$auth" "$url/api/v1/runs" | grep -q '"finished":true' && break; sleep 1; done
curl -sf -H "$auth" -H 'Content-Type: application/json' -d '{"why":"tested"}' "$url/api/v1/benches/demo/hold" > /dev/null

# With names that are there, then with any. The event stream has no end and is left to our own tests; `release` would let the queue go.
printf '[parameters]\nbench = "demo"\nrun = "demo-1"\nexperiment = "demo"\n' > "$work/named.toml"
printf '' > "$work/any.toml"
checks=not_a_server_error,status_code_conformance,content_type_conformance,response_schema_conformance,negative_data_rejection
for names in named any; do
  "$venv/bin/schemathesis" --config-file "$work/$names.toml" run "$url/api/v1/openapi.json" --header "$auth" --max-examples "$examples" \
    --workers 2 --seed 1 --request-timeout 60 --exclude-path /api/v1/events --exclude-path-regex '/release$' --phases coverage,fuzzing,stateful \
    --checks "$checks,unsupported_method,allow_header_conformance"
done
