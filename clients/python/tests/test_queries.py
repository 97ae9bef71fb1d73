"""Questions to a server that is really started; the answers are compared with what is computed here."""

from __future__ import annotations

import asyncio
import itertools
import math
from fractions import Fraction

import numpy as np
import pytest
from support import CELL_M, NX, NY, ORIGIN, VOID, Server, ground

import sightline
from sightline import Verdict


def on_map(i: float, j: float, z: float) -> tuple[float, float, float]:
    return ORIGIN[0] + CELL_M * i, ORIGIN[1] + CELL_M * j, z


def test_terrain(server: sightline.Client) -> None:
    terrain = server.terrain()
    assert (terrain.nx, terrain.ny, terrain.root_exponent) == (NX, NY, 7)
    assert terrain.scale == (CELL_M, CELL_M, 1.0)
    assert terrain.void_posts == 1
    assert terrain.map_from_grid(2, 3) == on_map(2, 3, 0)[:2]
    assert terrain.corner_heights[0] == ground(0, 0)


def test_heights_are_those_of_the_posts(server: sightline.Client) -> None:
    posts = [(i, j) for i in range(0, NX, 7) for j in range(0, NY, 5)] + [VOID, (NX + 3, 0)]
    found = server.heights(posts, frame="grid", normals=True)
    known = [p != VOID and p[0] < NX for p in posts]
    assert found.known.tolist() == known
    assert [z for z in found.z if z == z] == [ground(*p) for p, k in zip(posts, known, strict=True) if k]
    assert found.normals is not None and np.allclose(np.linalg.norm(found.normals[found.known], axis=1), 1)
    between = server.heights([(4.5, 3.0)], frame="grid").z[0]
    assert between == (ground(4, 3) + ground(5, 3)) / 2


def test_one_line(server: sightline.Client) -> None:
    low = server.line_of_sight(on_map(20, 30, 2), on_map(70, 40, 2), altitude="agl", derive=True)
    assert low.verdict is Verdict.BLOCKED and not low.visible and low.certain
    assert low.first_from_a is not None and low.deepest is not None and low.deepest > 0
    assert low.least_target_z is not None
    assert low.ends is not None and low.ends[0].tolist() == [20, 30, ground(20, 30) + 2]
    a, (bx, by, _) = low.ends[0], low.ends[1]
    raised = server.line_of_sight(a, (bx, by, low.least_target_z), frame="grid")
    assert raised.verdict is Verdict.VISIBLE
    high = server.line_of_sight(on_map(20, 30, 900), on_map(70, 40, 900), derive=True)
    assert high.visible and high.least_clearance is not None and high.least_clearance > 0
    over = server.line_of_sight((VOID[0] - 2, VOID[1], 500), (VOID[0] + 2, VOID[1], 500), frame="grid")
    assert over.verdict is Verdict.UNKNOWN
    assert over.unknown_reason is sightline.UnknownReason.UNKNOWN_GROUND


def test_stretches_cover_a_line(server: sightline.Client) -> None:
    low = server.line_of_sight((20, 30, 2), (70, 40, 2), frame="grid", altitude="agl", stretches=True)
    for stretches in (low.line, low.ground):
        assert stretches[0].start == 0 and stretches[-1].end == 1
        assert all(a.end == b.start for a, b in itertools.pairwise(stretches))
    assert sightline.LineState.BELOW in {s.state for s in low.line}
    assert {s.state for s in low.ground} == {sightline.GroundState.SEEN, sightline.GroundState.HIDDEN}


def test_a_stream_of_groups_answers_as_a_batch_does(server: sightline.Client) -> None:
    dice = np.random.default_rng(3)
    a, b = (np.column_stack([dice.uniform(0, NX - 1, 300), dice.uniform(0, NY - 1, 300), np.full(300, 3.0)]) for _ in "ab")
    ids = np.arange(300) + 7_000
    groups = [(ids[at : at + 30], a[at : at + 30], b[at : at + 30]) for at in range(0, 300, 30)]
    groups.insert(4, ([1], [[np.nan, 0, 0]], [[1, 1, 1]]))
    found, refused = {}, []
    for some, answers in server.stream_lines_of_sight(groups, frame="grid", altitude="agl"):
        if isinstance(answers, sightline.Refused):
            refused.append((some.tolist(), answers.code))
        else:
            found.update(zip(some.tolist(), answers.verdicts.tolist(), strict=True))
    wanted = server.lines_of_sight(a, b, frame="grid", altitude="agl").verdicts.tolist()
    assert [found[n] for n in ids] == wanted
    assert refused == [([1], "INVALID_ARGUMENT")]


def exact(a: list[float], b: list[float]) -> Verdict:
    """A line along a row of posts, by fractions: the ground is linear between two posts of a row."""
    (ax, j, az), (bx, _, bz) = ([Fraction(c) for c in end] for end in (a, b))
    low, high = sorted((ax, bx))
    for x in [low, high, *(Fraction(i) for i in range(NX) if low < i < high)]:
        i = min(int(x), NX - 2)
        floor = ground(i, int(j)) + (ground(i + 1, int(j)) - ground(i, int(j))) * (x - i)
        z = az + (bz - az) * (x - ax) / (bx - ax)
        if z < floor:
            return Verdict.BLOCKED
    return Verdict.VISIBLE


def test_a_batch_is_as_exact_as_fractions(server: sightline.Client) -> None:
    dice = np.random.default_rng(7)
    n = 400
    rows = dice.integers(25, NY, n)  # the void post is in none of these
    ax, bx = dice.uniform(0, NX - 1, n), dice.uniform(0, NX - 1, n)
    ax[::4], bx[::4] = np.rint(ax[::4]), np.rint(bx[::4]) + 0.5
    a = np.column_stack([ax, rows, dice.uniform(-20, 160, n)])
    b = np.column_stack([bx, rows, dice.uniform(-20, 160, n)])
    found = server.lines_of_sight(a, b, frame="grid")
    wanted = [exact(*pair) for pair in zip(a.tolist(), b.tolist(), strict=True)]
    assert found.verdicts.tolist() == wanted
    assert found.certain.all() and 0 < found.visible.sum() < n
    one_observer = server.lines_of_sight(a[:1], b, frame="grid")
    assert one_observer.verdicts.shape == (n,)


def test_batches_are_cut_where_a_call_ends(server: sightline.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sightline.aio, "BATCH_LINES", 7)
    b = np.array([(i, 10, ground(i, 10) + 5) for i in range(40)], dtype=float)
    whole = server.lines_of_sight([(3, 10, 150)], b, frame="grid")
    singles = [server.line_of_sight((3, 10, 150), end, frame="grid").verdict for end in b]
    assert whole.verdicts.tolist() == singles
    assert server.lines_of_sight(np.zeros((0, 3)), np.zeros((0, 3))).verdicts.shape == (0,)


def test_a_ray_ends_on_the_ground(server: sightline.Client) -> None:
    down = server.ray((10.25, 10.5, 500), 0, -90, 2000, frame="grid")
    assert down.end is sightline.RayEnd.HIT and down.hit is not None and down.normal is not None
    height = server.heights([down.hit[:2]], frame="grid").z[0]
    assert down.hit[2] == pytest.approx(height, abs=1e-9)
    up = server.ray((10.25, 10.5, 500), 0, 45, 2000, frame="grid")
    assert up.end is sightline.RayEnd.MISS and up.hit is None


def test_a_horizon_is_the_steepest_of_its_row(server: sightline.Client) -> None:
    found = server.horizon((30, 30, ground(30, 30) + 2), [90, 270], 1e5, frame="grid")
    for n, row in enumerate((range(31, NX), range(30))):
        slopes = {i: (ground(i, 30) - ground(30, 30) - 2) / (abs(i - 30) * CELL_M) for i in row}
        crest = max(slopes, key=lambda i: slopes[i])
        assert found.elevation_deg[n] == pytest.approx(math.degrees(math.atan(slopes[crest])))
        assert found.range_m[n] == pytest.approx(abs(crest - 30) * CELL_M)
    assert found.over_unknown.all() and not found.below_ground, "1e5 m lead beyond the grid"


def test_a_profile_passes_through_the_posts_of_its_row(server: sightline.Client) -> None:
    found = server.profile((0, 30), (NX - 1, 30), frame="grid")
    posts = {x: z for x, z in zip(found.x.tolist(), found.ground.tolist(), strict=True) if x == int(x)}
    assert posts == {i: ground(i, 30) for i in range(NX)}
    assert found.t[0] == 0 and found.t[-1] == 1 and (np.diff(found.t) > 0).all()
    gap = server.profile((VOID[0] - 3, VOID[1]), (VOID[0] + 3, VOID[1]), frame="grid")
    assert not gap.known_after[:-1].all() and np.isnan(gap.ground).sum() == 1
    assert not found.bulge.any()
    curved = server.profile((0, 30), (NX - 1, 30), frame="grid", earth_radius_m=1e5)
    assert (curved.ground == found.ground).all()
    length_m = (NX - 1) * CELL_M
    assert curved.bulge == pytest.approx(curved.t * (1 - curved.t) * length_m**2 / 2e5)


def test_a_viewshed_is_what_single_lines_say(server: sightline.Client) -> None:
    observer, target_height = (33, 30, 3), 2.0
    seen = server.viewshed(
        observer, rectangle=(20, 66, 18, 40), target_height_m=target_height, frame="grid", altitude="agl"
    )
    assert seen.cells.shape == (23, 47) and (seen.first_i, seen.first_j) == (20, 18)
    posts = [(i, j) for j in range(18, 41) for i in range(20, 67)]
    ends = np.array([(i, j, target_height) for i, j in posts], dtype=float)
    lines = server.lines_of_sight([observer], ends, frame="grid", altitude="agl")
    assert seen.cells.ravel().tolist() == lines.verdicts.tolist()
    assert sum(seen.counts().values()) == len(posts) and seen.counts()[Verdict.UNKNOWN] >= 1
    disc = server.viewshed(on_map(33, 30, 3), radius_m=300, altitude="agl")
    assert disc.cells.shape == (21, 21) and disc.cells[0, 0] == 0 and disc.cells[10, 0] != 0


def test_a_matrix_is_what_single_lines_say(server: sightline.Client) -> None:
    points = np.array([(5, 5, 4), (40, 30, 4), (50, 31, 4), (80, 60, 4), (20, 60, 4)], dtype=float)
    matrix = server.intervisibility(points, frame="grid", altitude="agl")
    assert (matrix == matrix.T).all() and (matrix.diagonal() == 0).all()
    for i, j in itertools.combinations(range(5), 2):
        assert matrix[i, j] == server.line_of_sight(points[i], points[j], frame="grid", altitude="agl").verdict


def test_refusals_name_what_is_wrong(server: sightline.Client) -> None:
    with pytest.raises(sightline.Refused) as refused:
        server.line_of_sight((float("nan"), 0, 0), (1, 1, 1), frame="grid")
    assert refused.value.code == "INVALID_ARGUMENT"
    with pytest.raises(sightline.Refused) as refused:
        server.line_of_sight((0, 0, 0), (1, 1, 1), frame="geographic")
    assert refused.value.code in ("INVALID_ARGUMENT", "FAILED_PRECONDITION")
    with pytest.raises(ValueError, match=r"\(n, 3\)"):
        server.lines_of_sight([1, 2], [3, 4])
    with pytest.raises(ValueError, match="frame"):
        server.line_of_sight((0, 0, 0), (1, 1, 1), frame="moon")  # type: ignore[arg-type]


def test_nobody_answers() -> None:
    with pytest.raises(sightline.ConnectError, match="is a Sightline server running there"):
        sightline.connect("127.0.0.1:9", connect_timeout_s=5)


def test_a_closed_connection_says_so(running: Server) -> None:
    closed, other = sightline.connect(running.address), sightline.connect(running.address)
    pose = sightline.Pose.looking((0, 0, 900), (900, 900, 0))
    view = closed.view(pose)
    view.frame()
    closed.close()
    closed.close()
    for call in (closed.terrain, view.frame, lambda: view.steer(pose), view.resume, lambda: closed.view(pose)):
        with pytest.raises(sightline.ConnectError, match="closed"):
            call()
    assert view.scene.mesh.triangle_count > 2, "what was received stays"
    assert other.terrain().nx == NX
    other.close()


def test_the_same_calls_with_asyncio(running: Server) -> None:
    async def ask() -> tuple[sightline.LineOfSight, sightline.Viewshed]:
        async with await sightline.aio.connect(running.address) as server:
            a, b = (20, 30, 2), (70, 40, 2)
            return await asyncio.gather(
                server.line_of_sight(a, b, frame="grid", altitude="agl"),
                server.viewshed(a, radius_m=200, frame="grid", altitude="agl"),
            )

    answer, seen = asyncio.run(ask())
    assert answer.verdict is Verdict.BLOCKED and seen.visible.any()


def test_a_viewshed_as_geotiff(server: sightline.Client, tmp_path) -> None:  # type: ignore[no-untyped-def]
    seen = server.viewshed(on_map(33, 30, 3), radius_m=300, altitude="agl")
    path = str(tmp_path / "seen.tif")
    try:
        import rasterio
    except ImportError:
        with pytest.raises(ImportError, match=r"sightline\[raster\]"):
            seen.to_geotiff(path)
        return
    seen.to_geotiff(path)
    with rasterio.open(path) as raster:
        cells = raster.read(1)
        row, column = raster.index(*on_map(33, 30, 0)[:2])
        assert (row, column) == (10, 10) and raster.nodata == 0
        north = raster.index(*on_map(33, 35, 0)[:2])
        assert cells[north] == seen.cells[15, 10]
