#!/usr/bin/env bash
# Whether a started server does what it should, from outside. usage: deploy/smoke.sh [ADDR]
# Needs the `sightline` command (or SIGHTLINE=path) and curl. The certificates and tokens of SIGHTLINE_AUTHORITIES and so
# on are for the command; the pages are asked in the clear.
set -euo pipefail
address=${1:-127.0.0.1:7410}
sightline=${SIGHTLINE:-sightline}
pictures=$(mktemp -d)
trap 'rm -rf "$pictures"' EXIT
fail() { echo "smoke: $1" >&2; exit 1; }
# Read to its end before anything looks for words: curl complains where its reader leaves early.
page() { curl -fsS "http://$address$1"; }

[ "$(page /healthz)" = ok ] || fail "/healthz is not ok"
grep -q Sightline <<<"$(page /)" || fail "the front page"
grep -q '^sightline_serving 1$' <<<"$(page /metrics)" || fail "/metrics does not say serving"
before=$(page /metrics | awk '/^sightline_frames_total/ { print $2 }')
grep -q verdict <<<"$("$sightline" los "http://$address" --from 1,1,10 --to 2,2,10 --coords grid --quiet --json)" || fail "los"
"$sightline" view "$address" -o "$pictures" --triangles 1000 --frames 20 --every 1000 --viewport 64x64 --quiet >/dev/null \
  || fail "view"
after=$(page /metrics | awk '/^sightline_frames_total/ { print $2 }')
[ "$after" -gt "${before:-0}" ] || fail "no frames were counted"
"$sightline" status "$address" --quiet >/dev/null || fail "status"
echo "smoke: all well at $address"
