"""Views of a watch: what they receive is what streams of their own do, they end with it, and they come back."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import pytest
from support import CELL_M, NX, NY, Server

import sightline
from sightline import Pace, Pose, Settings, SightLine
from sightline.links import MAX_WAITING

MIDDLE = (NX * CELL_M / 2, NY * CELL_M / 2, 0.0)


def poses(n: int) -> list[Pose]:
    return [Pose.looking((200 + 90 * k, 300 + 40 * k, 400.0), MIDDLE) for k in range(n)]


def register(client: sightline.Client, name: str) -> None:
    def at(i: float, j: float) -> sightline.AtPoint:
        return sightline.AtPoint((i, j, 2), frame="grid", altitude="agl")

    client.create_exercise(name)
    client.change_exercise(name, put_lines=[SightLine(n, at(5 + 8 * n, 10), at(80 - 5 * n, 60)) for n in range(1, 9)])


def hashes(view: sightline.View) -> list[int]:
    first = view.frame().mesh_hash
    return [first, *(view.frame_of(view.steer(pose)).mesh_hash for pose in poses(5)[1:])]


def test_a_watched_view_gets_the_meshes_of_a_streamed_one(server: sightline.Client) -> None:
    register(server, "watched")
    try:
        with server.watch() as watch:
            both = [watch.view(poses(1)[0], Settings(triangles=n), exercise="watched") for n in (120, 500)]
            found = [hashes(view) for view in both]
            assert all(view.scene.disagreements() == [] for view in both)
            both[0].close()
            both[1].request_snapshot()
            assert both[1].frame().base_sequence == 0, "one goes on without the other"
            both[1].change(Settings(triangles=50))
            while both[1].frame().triangles > 50:
                pass
        with pytest.raises(sightline.ConnectError, match="closed"):
            both[1].frame()
        for triangles, watched in zip((120, 500), found, strict=True):
            with server.view(poses(1)[0], Settings(triangles=triangles), exercise="watched") as streamed:
                assert hashes(streamed) == watched
    finally:
        server.delete_exercise("watched")


def test_refusals_and_ends_of_watched_views(server: sightline.Client) -> None:
    register(server, "ends")
    with server.watch() as watch:
        with pytest.raises(sightline.Refused, match="NOT_FOUND"):
            watch.view(poses(1)[0], exercise="nowhere")
        with watch.view(poses(1)[0], Settings(triangles=99)) as other:
            with watch.view(poses(1)[0], exercise="ends") as view:
                view.frame()
                server.delete_exercise("ends")
                with pytest.raises(sightline.SightlineError):
                    while True:
                        view.frame(timeout_s=20)
            assert other.frame().triangles > 0, "it ends alone"


def test_watched_views_come_back_after_the_server_was_killed(database: Path) -> None:
    server = Server(database)
    server.start()
    try:
        with sightline.connect(server.address) as client, client.watch() as watch:
            views = [watch.view(poses(1)[0], Settings(triangles=n)) for n in (100, 300)]
            before = [view.frame_of(view.steer(poses(3)[2])).mesh_hash for view in views]
            server.kill()
            for view, held in zip(views, before, strict=True):
                with pytest.raises(sightline.ConnectError):
                    view.frame(timeout_s=20)
                assert view.scene.mesh.hash == held
            server.start()
            for view, held in zip(views, before, strict=True):
                view.resume()
                frame = view.frame()
                assert (frame.base_sequence, frame.mesh_hash) == (0, held)
    finally:
        server.kill()


def test_a_reader_that_never_reads_is_told_so(running: Server) -> None:
    async def talk() -> None:
        async with await sightline.aio.connect(running.address) as client, client.watch() as watch:
            view = await watch.view(poses(1)[0], Settings(triangles=99))
            frame = await view.frame()
            message = sightline.v1.scene_pb2.StreamSceneResponse()
            message.exercise.epoch = 1
            for _ in range(MAX_WAITING + 1):  # as a server would that waits for no acknowledgement
                view._link.take(message)  # type: ignore[union-attr]
            with pytest.raises(sightline.ProtocolError, match="before it acknowledged"):
                for _ in range(MAX_WAITING + 1):
                    await view.frame(timeout_s=5)
            assert view.scene.mesh.hash == frame.mesh_hash

    asyncio.run(talk())


@pytest.mark.parametrize("watched", [False, True])
def test_a_pace_is_kept(server: sightline.Client, watched: bool) -> None:
    with server.watch() as watch:
        opener = watch if watched else server
        rate_hz, seconds = 5.0, 0.9
        with opener.view(poses(1)[0], Settings(triangles=200), pace=Pace(max_rate_hz=rate_hz)) as view:
            frames, begin, k = [view.frame()], time.monotonic(), 0
            while time.monotonic() - begin < seconds:
                k += 1
                frames.append(view.frame_of(view.steer(poses(9)[k % 9])))
            assert 2 <= len(frames) <= 2 + rate_hz * (time.monotonic() - begin)
            assert max(frame.held_back_ms for frame in frames) > 1000 / rate_hz / 2
            view.change(pace=Pace())
            held = [view.frame_of(view.steer(pose)).held_back_ms for pose in poses(9)]
            assert held[1:] == [0] * 8, "the pace is over"
    with pytest.raises(sightline.Refused, match="INVALID_ARGUMENT"):
        server.view(poses(1)[0], pace=Pace(max_bytes_per_s=1))


def test_a_bandwidth_is_kept(server: sightline.Client) -> None:
    per_second = 4_000
    with server.view(poses(1)[0], Settings(triangles=1_500), pace=Pace(max_bytes_per_s=per_second)) as view:
        first, begin = view.frame(), time.monotonic()
        sent = first.payload_bytes
        for _ in range(2):
            view.request_snapshot()
            sent += view.frame().payload_bytes
        # What is on its way when the clock stops is the last frame.
        assert time.monotonic() - begin >= (sent - view.scene.frame.payload_bytes) / per_second * 0.8
