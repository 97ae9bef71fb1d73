#!/usr/bin/env python3
"""Embree (PyPI embreex, numpy) on the lines that the benchmark exports: occlusion rays on the triangle mesh, one core.

    mkdir lines && cargo run --release --manifest-path tests/bench/Cargo.toml -- DATABASE --export lines
    python3 tests/bench/embree.py lines [SIDE]

Run the benchmark itself in the same session: only ratios of one session mean anything. Positions are f32, as Embree's
are, relative to the middle of the grid; answers are compared with nothing, since near ties they are not to be trusted.
"""

import pathlib
import sys
import time

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh

folder = pathlib.Path(sys.argv[1])
side = int(sys.argv[2]) if len(sys.argv) > 2 else 4097
heights = np.fromfile(folder / "heights.f32", "<f4").reshape(side, side)
half = (side - 1) / 2

x, y = np.meshgrid(np.arange(side, dtype="f4") - half, np.arange(side, dtype="f4") - half)
vertices = np.stack([x, y, heights], -1).reshape(-1, 3).astype("f4")
i, j = np.meshgrid(np.arange(side - 1), np.arange(side - 1))
sw = (j * side + i).ravel()
se, nw, ne = sw + 1, sw + side, sw + side + 1
rises = ((i + j) % 2 == 0).ravel()
first = np.where(rises[:, None], np.stack([sw, se, ne], 1), np.stack([sw, se, nw], 1))
second = np.where(rises[:, None], np.stack([sw, ne, nw], 1), np.stack([se, ne, nw], 1))
faces = np.concatenate([first, second]).astype("i4")

scene = rtcore_scene.EmbreeScene()
TriangleMesh(scene, vertices, faces)
for name in ["long", "short"]:
    lines = np.fromfile(folder / f"{name}.f64", "<f8").reshape(-1, 2, 3) - np.array([half, half, 0.0])
    origins = lines[:, 0].astype("f4")
    directions = (lines[:, 1] - lines[:, 0]).astype("f4")
    best = np.inf
    for _ in range(5):
        # The direction is the whole line, so what is hit beyond a distance of 1 is beyond B.
        reach = np.ones(len(lines), "f4")
        started = time.perf_counter()
        hits = scene.run(origins, directions, dists=reach, query="OCCLUDED")
        best = min(best, time.perf_counter() - started)
    blocked = int((np.asarray(hits) != -1).sum())
    rate = len(lines) / best / 1e6
    print(f"{name}: {rate:.3f} million/s, {1 / rate:.3f} us a line, {blocked} of {len(lines)} blocked")
