#!/usr/bin/env python3
"""gdal_viewshed on the viewsheds that the benchmark exports: time a cell on one core, cells that differ from the exact ones.

    mkdir seen && cargo run --release --manifest-path tests/bench/Cargo.toml --bin viewshed -- DATABASE --export seen
    python3 tests/bench/gdal.py seen

Run both in one session: only ratios of one session mean anything. GDAL's time is the processor's for the whole command,
less that for a viewshed of a few cells, so reading and writing a million cells count. It interpolates heights between
rings of cells around the observer, so it answers about another surface than ours.
"""

import pathlib
import resource
import subprocess
import sys
import tempfile


def seconds(source: pathlib.Path, view: list[str], out: str, reach: float) -> float:
    """Of the processor, the least of three runs."""
    x, y, above, target = view
    command = ["gdal_viewshed", "-q", "-b", "1", "-ox", x, "-oy", y, "-oz", above, "-tz", target, "-md", str(reach)]
    command += ["-cc", "0", "-vv", "1", "-iv", "0", "-of", "ENVI", str(source), out]
    least = float("inf")
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        least = min(least, after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime)
    return least


for source in sorted(pathlib.Path(sys.argv[1]).glob("*.bil")):
    view = source.with_suffix(".view").read_text().split()
    exact = source.with_suffix(".cells").read_bytes()
    with tempfile.TemporaryDirectory() as folder:
        out = f"{folder}/seen"
        start = seconds(source, view, out, 2)
        whole = seconds(source, view, out, 1e6)
        found = pathlib.Path(out).read_bytes()
    if len(found) != len(exact):
        sys.exit(f"{source}: {len(found)} cells, not {len(exact)}")
    wrong = sum(a != b for a, b in zip(found, exact))
    each = 1e9 * (whole - start) / len(exact)
    print(f"{source.stem}: {each:.1f} ns a cell, {wrong} of {len(exact)} cells differ ({100 * wrong / len(exact):.2f} %)")
