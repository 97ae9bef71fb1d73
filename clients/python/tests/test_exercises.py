"""What exercises ask of meshes beside verdicts: ranges and regions of lines, ground under entities; leases; and how a server is."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from support import CELL_M, NX, NY, ORIGIN

import sightline
from sightline import (
    AtEntity,
    AtPoint,
    Disc,
    Entity,
    Fidelity,
    Lease,
    Pose,
    Recording,
    Settings,
    SightLine,
    UnknownReason,
    Verdict,
    convert,
)
from sightline.v1 import operation_pb2 as operation

EYE = Pose.looking((200.0, 300.0, 400.0), (NX * CELL_M / 2, NY * CELL_M / 2, 0.0))


@pytest.fixture
def exercise(server: sightline.Client) -> Iterator[str]:
    server.create_exercise("asks")
    yield "asks"
    server.delete_exercise("asks")


def post(i: float, j: float, z: float = 2.0) -> AtPoint:
    return AtPoint((i, j, z), frame="grid", altitude="agl")


def test_a_line_beyond_its_range_or_region_asks_nothing(server: sightline.Client, exercise: str) -> None:
    a, b, length_m = post(10, 10, 300), post(30, 10, 300), 20 * CELL_M
    around_a = (ORIGIN[0] + 10 * CELL_M, ORIGIN[1] + 10 * CELL_M)
    lines = {
        1: SightLine(1, a, b),
        2: SightLine(2, a, b, range_m=1.2 * length_m),
        3: SightLine(3, a, b, range_m=0.8 * length_m),
        4: SightLine(4, a, b, region=Disc(around_a, 1.1 * length_m)),
        5: SightLine(5, a, b, region=Disc(around_a, 0.9 * length_m)),
        6: SightLine(6, a, b, region=Disc((20, 10), 0.6 * length_m, frame="grid")),
    }
    server.change_exercise(exercise, put_lines=lines.values())
    stated = server.exercise(exercise).lines
    assert {n for n, line in stated.items() if line.verdict is Verdict.VISIBLE} == {1, 2, 4, 6}
    for n in (3, 5):
        assert (stated[n].verdict, stated[n].unknown_reason) == (Verdict.UNKNOWN, UnknownReason.INACTIVE)
    assert stated[1].unknown_reason is UnknownReason.NOT_UNKNOWN


def test_a_blocked_line_says_where(server: sightline.Client, exercise: str) -> None:
    a, b = post(20, 30), post(70, 40)
    line = SightLine(1, a, b, fidelity=Fidelity.OBSTRUCTION, obstruction_distance_m=40.0)
    server.change_exercise(exercise, put_lines=[line])
    stated = server.exercise(exercise).lines[1]
    asked = server.line_of_sight(a.position, b.position, frame="grid", altitude="agl", derive=True)
    assert asked.ends is not None and asked.first_from_a is not None
    assert (stated.fidelity, stated.obstruction_distance_m) == (Fidelity.OBSTRUCTION, 40.0)
    at = asked.ends[0] + stated.first_obstruction * (asked.ends[1] - asked.ends[0])
    assert at == pytest.approx(asked.first_from_a.position, abs=1e-6)


def height_on_mesh(scene: sightline.Scene, x: float, y: float) -> float:
    """By the triangle over a place; grid frame."""
    vertices, triangles = scene.mesh.vertices("grid"), scene.mesh.triangles()
    for corners in vertices[triangles]:
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = corners.tolist()
        u, v = np.linalg.solve([[bx - ax, cx - ax], [by - ay, cy - ay]], [x - ax, y - ay])
        if u >= -1e-12 and v >= -1e-12 and u + v <= 1 + 1e-12:
            return float(az + u * (bz - az) + v * (cz - az))
    raise AssertionError(f"no triangle over {x}, {y}")


def test_an_entity_stands_on_its_ground_or_is_named(server: sightline.Client, exercise: str) -> None:
    places = {1: (45.25, 33.5), 2: (12.0, 50.0)}
    near_m = 0.5
    entities = [Entity(n, (x, y, 0), frame="grid", altitude="agl", ground_m=near_m) for n, (x, y) in places.items()]
    server.change_exercise(exercise, put_entities=entities)
    assert {e.ground_m for e in server.exercise(exercise).entities} == {near_m}
    ground = dict(zip(places, server.heights(list(places.values()), frame="grid").z.tolist(), strict=True))
    seen = []
    with server.view(EYE, Settings(triangles=4), exercise=exercise) as view:
        view.frame()
        for budget in (4, 60, 400, 60):
            view.change(Settings(triangles=budget))
            view.request_snapshot()
            while view.frame().base_sequence != 0:
                pass
            off = {n for n, p in places.items() if abs(height_on_mesh(view.scene, *p) - ground[n]) > near_m + 1e-9}
            assert off <= view.scene.off_ground, f"with {budget} triangles"
            seen.append(len(view.scene.off_ground))
    assert seen[0] == 2 and seen[2] == 0


def test_a_line_says_what_it_lacks(server: sightline.Client, exercise: str) -> None:
    ends = [(post(5 + 3 * n, 10 + 5 * n % 50), post(80 - 3 * n, 60 - 2 * n)) for n in range(24)]
    server.change_exercise(exercise, put_lines=[SightLine(n + 1, a, b) for n, (a, b) in enumerate(ends)])
    few, checked = 6, 0
    for n in range(1, 25):

        def named_with(triangles: int, line: int = n) -> int | None:
            settings = Settings(triangles=triangles, lines=[line])
            with server.view(Pose.looking((0, 0, 5e4), (0, 0, 0)), settings, exercise=exercise) as view:
                view.frame()
                return view.scene.unsatisfied.get(line)

        lacking = named_with(few)
        if lacking:
            assert named_with(2 + lacking - 1) is not None, f"line {n} needs {lacking} beside the first two"
            assert named_with(4_000) is None
            checked += 1
    assert checked > 3


def test_a_status_counts(server: sightline.Client) -> None:
    before = server.status()
    with server.view(EYE, Settings(triangles=100)) as view:
        view.frame()
        server.lines_of_sight([(5, 5, 900)], [(6 + n, 6, 900) for n in range(10)], frame="grid")
        now = server.status()
    assert now.serving and now.troubles == () and now.version and now.uptime_s >= before.uptime_s
    assert now.visible - before.visible == 10 and now.frames > before.frames
    assert now.recording is None
    told = operation.GetStatusResponse(recording=operation.RecordingState(bytes=5, limit_bytes=9, ended="full"))
    assert convert.status(told).recording == Recording(5, 9, "full")
    assert now.limits["views"].used == before.limits["views"].used + 1 <= now.limits["views"].limit


def test_leases_and_watches_of_verdicts(server: sightline.Client, exercise: str) -> None:
    entities = [Entity(n, (n * 9, 20, 0.0), frame="grid", altitude="agl") for n in range(1, 7)]
    lines = [SightLine(n, AtEntity(n, 2.0), AtEntity(n % 4 + 1, 2.0)) for n in range(1, 5)]
    server.change_exercise(exercise, put_entities=entities[:4], put_lines=lines)
    # Held before there is anything under it.
    watch = server.watch_exercise(exercise, lease_owner="test")
    assert next(watch).changed == {n: line.verdict for n, line in server.exercise(exercise).lines.items()}
    brief = SightLine(70, AtEntity(5, 2.0), AtEntity(6, 2.0))
    server.change_exercise(exercise, put_entities=entities[4:], put_lines=[brief], lease=Lease("test", 1))
    assert list(next(watch).changed) == [70]
    (lease,) = server.exercise(exercise).leases
    assert (lease.owner, lease.streams, lease.entities, lease.sight_lines) == ("test", 1, 2, 1)
    assert server.renew_lease(exercise, "test") == 1
    server.change_exercise(exercise, remove_lines=[2])
    assert next(watch).removed == (2,)
    other = server.watch_exercise(exercise, lines=[70])
    assert list(next(other).changed) == [70]
    with server.view(EYE, Settings(triangles=300), exercise=exercise, lease_owner="test") as view:
        view.frame()
        assert server.exercise(exercise).leases[0].streams == 2
    watch.close()
    # Nothing holds the lease any more, and its term is a second.
    end = next(other)
    assert (end.removed, end.expired_owners) == ((70,), ("test",))
    assert [entity.id for entity in server.exercise(exercise).entities] == [1, 2, 3, 4]
    with pytest.raises(sightline.Refused) as refused:
        server.renew_lease(exercise, "test")
    assert refused.value.code == "NOT_FOUND"
    server.create_exercise("brief", lease=Lease("test", 600))
    assert server.exercise("brief").leases[0].holds_exercise
    with pytest.raises(sightline.Refused, match="has ended"):
        for _ in server.watch_exercise("brief"):
            server.delete_exercise("brief")
