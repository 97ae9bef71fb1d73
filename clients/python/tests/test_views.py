"""Scene streams of a server that is really started, and conformance, part 3: resuming after it was killed."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from support import CELL_M, NX, NY, Server

import sightline
from sightline import AtEntity, AtPoint, Entity, Pose, Settings, SightLine

EYE = (200.0, 300.0, 400.0)
TARGET = (NX * CELL_M / 2, NY * CELL_M / 2, 0.0)


def entities() -> list[Entity]:
    places = [(10 + 7 * k, 8 + (k * 23) % 50) for k in range(10)]
    return [Entity(k + 1, (x, y, 0.0), frame="grid", altitude="agl") for k, (x, y) in enumerate(places)]


def lines() -> list[SightLine]:
    pairs = [(a, b) for a in range(1, 11) for b in range(a + 1, 11, 2)]
    return [SightLine(k + 1, AtEntity(a, 2.0), AtEntity(b, 1.5)) for k, (a, b) in enumerate(pairs)]


@pytest.fixture
def exercise(server: sightline.Client) -> Iterator[str]:
    server.create_exercise("py")
    server.change_exercise("py", put_entities=entities(), put_lines=lines())
    yield "py"
    server.delete_exercise("py")


def poses(n: int) -> list[Pose]:
    return [Pose.looking((200 + 90 * k, 300 + 40 * k, 400.0), TARGET) for k in range(n)]


def test_exercises(server: sightline.Client, exercise: str) -> None:
    assert ("py", 1, 10, len(lines())) in [
        (e.name, e.epoch, e.entities, e.sight_lines) for e in server.exercises()
    ]
    stated = server.exercise("py")
    assert len(stated.lines) == len(lines()) and len(stated.entities) == 10
    ends = [line.ends for line in stated.lines.values()]
    a, b = ([end[k] for end in ends if end] for k in (0, 1))
    asked = server.lines_of_sight(a, b, frame="grid").verdicts.tolist()
    assert asked == [line.verdict for line in stated.lines.values()]
    point = AtPoint((5, 5, 2), frame="grid", altitude="agl")
    epoch = server.change_exercise("py", remove_lines=[1], put_lines=[SightLine(99, point, AtEntity(3))])
    assert epoch == 2 and 1 not in server.exercise("py").lines and 99 in server.exercise("py").lines
    with pytest.raises(sightline.Refused) as refused:
        server.exercise("nowhere")
    assert refused.value.code == "NOT_FOUND"


def test_a_view_is_right_in_every_frame(server: sightline.Client, exercise: str) -> None:
    with server.view(poses(1)[0], Settings(triangles=400), exercise=exercise) as view:
        view.frame()
        deltas = 0
        for pose in poses(12)[1:]:
            number = view.steer(pose)
            frame = view.frame_of(number)
            deltas += frame.base_sequence != 0
            scene = view.scene
            assert scene.mesh.triangle_count == frame.triangles <= 400
            assert scene.disagreements() == []
            assert len(scene.verdicts()) == len(lines())
        assert deltas > 0
        vertices, triangles = view.scene.mesh.vertices(), view.scene.mesh.triangles()
        assert vertices.shape[1] == 3 and triangles.max() == len(vertices) - 1
        area = 0.0
        a, b, c = (vertices[triangles[:, k]] for k in range(3))
        area = (((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2).sum()
        assert area >= (NX - 1) * (NY - 1) * CELL_M**2


def test_epochs_and_settings_reach_a_view(server: sightline.Client, exercise: str) -> None:
    with server.view(poses(1)[0], Settings(triangles=600), exercise=exercise) as view:
        view.frame()
        epoch = server.change_exercise("py", put_entities=[Entity(1, (70, 60, 0), frame="grid", altitude="agl")])
        while view.frame().epoch < epoch:
            pass
        stated = server.exercise("py").lines
        assert view.scene.lines == stated and view.scene.disagreements() == []
        view.change(Settings(triangles=60))
        while view.frame().triangles > 60:
            pass
        assert view.scene.disagreements() == []
        view.change(Settings(triangles=600, lines=[2, 3]))
        while set(view.scene.lines) != {2, 3}:
            view.frame()
        view.request_snapshot()
        while view.frame().base_sequence != 0:
            pass


def test_a_region_is_finer(server: sightline.Client) -> None:
    def posts_inside(settings: Settings) -> int:
        with server.view(poses(1)[0], settings) as view:
            view.frame()
            vertices = view.scene.mesh.vertices()
        return int((np.hypot(vertices[:, 0] - 1800, vertices[:, 1] - 1200) < 200).sum())

    region = sightline.Region(1800.0, 1200.0, 200.0, 1000.0)
    assert posts_inside(Settings(triangles=400, regions=[region])) > 2 * posts_inside(Settings(triangles=400))


def test_a_parallel_projection(server: sightline.Client) -> None:
    down = Pose.looking((TARGET[0], TARGET[1], 3000.0), TARGET)
    with server.view(down, Settings(triangles=400, half_height_m=1500.0)) as view:
        assert view.frame().triangles in (399, 400)


def test_a_mesh_that_was_lost_is_asked_for_again(server: sightline.Client) -> None:
    with server.view(poses(1)[0], Settings(triangles=300)) as view:
        view.frame()
        view.scene.mesh = view.scene.mesh.with_posts({})  # a replica that has lost its posts
        number = view.steer(poses(6)[5])
        frame = view.frame_of(number)
        assert frame.base_sequence == 0 and view.scene.mesh.hash == frame.mesh_hash


def test_without_a_frame_due_waiting_ends(server: sightline.Client) -> None:
    with server.view(poses(1)[0], Settings(triangles=300)) as view:
        view.frame()
        with pytest.raises(TimeoutError):
            view.frame(timeout_s=0.2)
        frame = view.frame_of(view.steer(poses(3)[2]))
        assert frame.triangles > 0


def test_a_view_that_makes_no_sense_is_refused(server: sightline.Client) -> None:
    with pytest.raises(sightline.Refused) as refused:
        server.view(poses(1)[0], Settings(triangles=1))
    assert refused.value.code == "INVALID_ARGUMENT"
    with pytest.raises(sightline.Refused) as refused:
        server.view(poses(1)[0], exercise="nowhere")
    assert refused.value.code == "NOT_FOUND"


def test_resume_after_the_server_was_killed(database: Path) -> None:
    server = Server(database)
    server.start()
    try:
        with sightline.connect(server.address) as client:

            def register() -> None:
                client.create_exercise("again")
                client.change_exercise("again", put_entities=entities(), put_lines=lines())

            register()
            with client.view(poses(1)[0], Settings(triangles=500), exercise="again") as view:
                view.frame()
                view.frame_of(view.steer(poses(5)[4]))
                before = view.scene.mesh.hash, view.scene.verdicts()
                server.kill()
                with pytest.raises(sightline.ConnectError):
                    view.frame(timeout_s=20)
                assert view.scene.mesh.hash == before[0], "what was received stays"
                server.start()
                with pytest.raises(sightline.Refused, match="NOT_FOUND"):
                    view.resume()
                register()
                view.resume()
                assert view.scene.mesh.hash == before[0] and view.scene.frame is None, "until the first frame"
                frame = view.frame()
                assert frame.base_sequence == 0
                assert view.scene.verdicts() == before[1] and view.scene.disagreements() == []
                with client.view(poses(5)[4], Settings(triangles=500), exercise="again") as fresh:
                    assert fresh.frame().mesh_hash == frame.mesh_hash, "the same inputs, the same mesh"
    finally:
        server.kill()


def test_two_views_with_asyncio(running: Server) -> None:
    async def fly(server: sightline.aio.Client, triangles: int) -> int:
        async with await server.view(Pose.looking(EYE, TARGET), Settings(triangles=triangles)) as view:
            await view.frame()
            for pose in poses(4):
                await view.frame_of(await view.steer(pose))
            return view.scene.mesh.triangle_count

    async def both() -> list[int]:
        async with await sightline.aio.connect(running.address) as server:
            return await asyncio.gather(fly(server, 200), fly(server, 900))

    few, many = asyncio.run(both())
    assert few <= 200 < many <= 900
