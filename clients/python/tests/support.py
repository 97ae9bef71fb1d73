"""What the tests share: the repository's vectors, and a server that is really started."""

from __future__ import annotations

import json
import math
import os
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]


def wire_vectors() -> list[dict[str, str]]:
    """The vectors of proto/vectors/mesh.txt, each by its keys."""
    vectors: list[dict[str, str]] = []
    for line in (ROOT / "proto/vectors/mesh.txt").read_text().splitlines():
        if line and not line.startswith("#"):
            key, _, value = line.partition(" ")
            if key == "vector":
                vectors.append({})
            vectors[-1][key] = value
    return vectors


def posts(text: str) -> dict[tuple[int, int], int]:
    """Posts with heights: i,j,height by spaces."""
    triples = [tuple(map(int, triple.split(","))) for triple in text.split()]
    return {(i, j): z for i, j, z in triples}


def heights(name: str) -> list[list[float]]:
    """A grid of tests/conformance, southernmost row first."""
    text = (ROOT / "tests/conformance" / f"{name}.csv").read_text()
    return [[float(cell) for cell in row.split(",")] for row in text.splitlines()]


def sightline_binary() -> Path:
    """The server under test: SIGHTLINE, or the repository's release build."""
    named = os.environ.get("SIGHTLINE")
    return Path(named) if named else ROOT / "target/release/sightline"


NX, NY, CELL_M = 90, 70, 30.0
ORIGIN = 1015.0, 2015.0
"""Map coordinates of the south-west post."""
VOID = (60, 20)


def ground(i: int, j: int) -> int:
    """Hills: the height of a post, in metres and in height units."""
    ridge = 120 * math.exp(-(((i - 45) / 6) ** 2))
    return round(ridge + 40 * math.sin(i / 5) * math.cos(j / 7) + 15 * math.sin(i * 1.3 + j * 0.9))


def write_terrain(path: Path) -> None:
    """An Esri ASCII grid of the hills, with one void post."""
    head = f"ncols {NX}\nnrows {NY}\nxllcenter {ORIGIN[0]}\nyllcenter {ORIGIN[1]}\ncellsize {CELL_M}\nNODATA_value -9999\n"
    rows = [
        " ".join(str(-9999 if (i, j) == VOID else ground(i, j)) for i in range(NX)) for j in reversed(range(NY))
    ]
    path.write_text(head + "\n".join(rows) + "\n")


class Server:
    """A `sightline serve` that is really started, can be killed, and started again at the same address."""

    def __init__(self, database: Path) -> None:
        self.database = database
        self.address = "127.0.0.1:0"
        self.process: subprocess.Popen[str] | None = None

    def start(self) -> None:
        command = [sightline_binary(), "serve", self.database, "--listen", self.address, "--json", "--quiet"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout
        self.address = json.loads(self.process.stdout.readline())["address"]

    def kill(self) -> None:
        if self.process:
            self.process.kill()
            self.process.wait()
            self.process = None
