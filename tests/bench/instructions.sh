#!/usr/bin/env bash
# Instructions of the hot loops by callgrind, over synthetic terrain, so that anyone gets the same numbers with the same
# compiler: of a line of sight one by one (short: up to 1 km; long: across 1025 x 1025 posts), of a line of a sorted batch
# (its sorting included), of the plain f64 walk for comparison, and of a cell of a viewshed. Needs valgrind.
#
#     tests/bench/instructions.sh
set -euo pipefail
cd "$(dirname "$0")"
folder=${CARGO_TARGET_DIR:-target}
cargo build --release --quiet --locked --bin sightline-bench --bin viewshed
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

# Instructions within the function `measured` of a program, divided by a count.
count() {
  local what=$1 by=$2
  shift 2
  RAYON_NUM_THREADS=1 valgrind --tool=callgrind --toggle-collect='*measured*' --callgrind-out-file="$scratch/out" \
    "$@" >/dev/null 2>"$scratch/log" || { cat "$scratch/log" >&2; exit 1; }
  printf '%-28s %s\n' "$what" "$(($(sed -n 's/^\(summary\|totals\): *//p' "$scratch/out" | tail -1) / by))"
}

lines=4000
for length in short long; do
  for way in exact batch grid; do
    count "$length line, $way" $lines "$folder/release/sightline-bench" --side 1025 --lines $length --only $way --count $lines
  done
done
count "cell of a viewshed" 1000000 "$folder/release/viewshed" --only
