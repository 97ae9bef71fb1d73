"""Conformance, part 4: verdicts on the mesh."""

from __future__ import annotations

import csv
import math

import pytest
from support import ROOT, heights

from sightline import Verdict, verdict_on_mesh
from sightline.mesh import Grid, Mesh

CONFORMANCE = ROOT / "tests/conformance"


def vector_meshes() -> dict[str, Mesh]:
    """The meshes of mesh.csv, with the heights of their grids, padding like the nearest post."""
    found = {}
    csv.field_size_limit(1 << 24)
    for row in csv.DictReader((CONFORMANCE / "mesh.csv").open()):
        rows = heights(row["grid"])
        nx, ny = len(rows[0]), len(rows)
        height = lambda i, j: int(rows[min(j, ny - 1)][min(i, nx - 1)])  # noqa: E731
        grid = Grid(nx, ny, (max(nx, ny) - 2).bit_length())
        corners = [height(i, j) for j in (0, grid.side) for i in (0, grid.side)]
        closed = [tuple(map(int, pair.split(","))) for pair in row["closed_vertices"].split()]
        on_corner = {(i, j) for i in (0, grid.side) for j in (0, grid.side)}
        mesh = Mesh(grid, corners).with_posts({(i, j): height(i, j) for i, j in closed if (i, j) not in on_corner})
        assert mesh.triangle_count == int(row["triangles"])
        found[row["mesh"]] = mesh
    return found


def test_conformance_of_verdicts_on_meshes() -> None:
    meshes = vector_meshes()
    lines = list(csv.DictReader((CONFORMANCE / "mesh_sight_lines.csv").open()))
    assert len(lines) > 1000
    wrong = []
    for line in lines:
        a = [float(line[c]) for c in ("ax", "ay", "az")]
        b = [float(line[c]) for c in ("bx", "by", "bz")]
        mesh, wanted = meshes[line["mesh"]], Verdict[line["verdict_on_mesh"]]
        if verdict_on_mesh(mesh, a, b) is not wanted or verdict_on_mesh(mesh, b, a) is not wanted:
            wrong.append(line)
    assert not wrong


def peak() -> Mesh:
    """A pyramid: four triangles, 10 high in the middle of 4 x 4 cells."""
    return Mesh(Grid(5, 5, 2), [0, 0, 0, 0]).with_posts({(2, 2): 10})


def test_contact_does_not_block_and_one_unit_in_the_last_place_below_does() -> None:
    mesh = peak()
    # Over the summit, where the line dips below the plane of the western side but not below that side.
    a, b = (0.0, 2.0, 12.0), (4.0, 2.0, 8.0)
    lower = (4.0, 2.0, math.nextafter(8.0, 0.0))
    for turn in (lambda p: p, lambda p: (p[1], p[0], p[2])):
        assert verdict_on_mesh(mesh, turn(a), turn(b)) is Verdict.VISIBLE
        assert verdict_on_mesh(mesh, turn(b), turn(a)) is Verdict.VISIBLE
        assert verdict_on_mesh(mesh, turn(a), turn(lower)) is Verdict.BLOCKED
        assert verdict_on_mesh(mesh, turn(lower), turn(a)) is Verdict.BLOCKED
    # In the ground, along an edge; and below it.
    assert verdict_on_mesh(mesh, (0, 0, 0), (2, 2, 10)) is Verdict.VISIBLE
    assert verdict_on_mesh(mesh, (0, 0, 0), (2, 2, math.nextafter(10, 0))) is Verdict.BLOCKED


def test_only_what_is_over_the_grid_blocks() -> None:
    mesh = peak()
    assert verdict_on_mesh(mesh, (-1, 1, -5), (1, -1, -5)) is Verdict.BLOCKED, "its corner is of the grid"
    assert verdict_on_mesh(mesh, (-1, 1, -5), (1, -1.0000001, -5)) is Verdict.VISIBLE
    assert verdict_on_mesh(mesh, (5, 0, -5), (5, 4, -5)) is Verdict.VISIBLE
    padded = Mesh(Grid(4, 5, 2), [0, 0, 0, 0])
    assert verdict_on_mesh(padded, (3.5, 1, -5), (3.5, 3, -5)) is Verdict.VISIBLE, "beyond the last column"
    assert verdict_on_mesh(padded, (3, 1, -5), (3, 3, -5)) is Verdict.BLOCKED


def test_points_and_vertical_lines() -> None:
    mesh = peak()
    for z, wanted in ((10.0, Verdict.VISIBLE), (math.nextafter(10.0, 0.0), Verdict.BLOCKED)):
        assert verdict_on_mesh(mesh, (2, 2, z), (2, 2, z)) is wanted
        assert verdict_on_mesh(mesh, (2, 2, 1e300), (2, 2, z)) is wanted
    assert verdict_on_mesh(mesh, (1, 2, 5e-324), (1, 2, 4e15)) is Verdict.BLOCKED
    assert verdict_on_mesh(mesh, (5e-324, 2, 5e-324), (0, 2, 0)) is Verdict.BLOCKED, "the ground is 5 times as high there"


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_coordinate_that_is_not_finite_is_an_error(bad: float) -> None:
    with pytest.raises(ValueError, match="finite"):
        verdict_on_mesh(peak(), (bad, 0, 0), (1, 1, 1))
