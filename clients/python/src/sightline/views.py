"""Views of a server: each one steers, receives, checks and acknowledges; a watch carries several on one stream."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Awaitable, Callable
from types import TracebackType
from typing import TYPE_CHECKING, Any

from .camera import Pace, Pose, Settings
from .errors import ConnectError, ProtocolError, SightlineError
from .links import Link, WatchStream
from .scene import Frame, Scene
from .v1 import scene_pb2

if TYPE_CHECKING:
    from .aio import Client

Opener = Callable[[scene_pb2.OpenView], Awaitable[Link]]
"""Opens a view, once and after each loss of the connection."""


class View:
    """One view: steers, receives, checks, acknowledges. Made by :meth:`Client.view` and :meth:`Watch.view`.

    Close it, or use it in ``async with``. Its state is that after the last frame: see :class:`sightline.Scene`.
    """

    def __init__(
        self,
        client: Client,
        opener: Opener,
        pose: Pose,
        settings: Settings,
        exercise: str,
        pace: Pace | None,
        lease_owner: str,
    ) -> None:
        self._client, self._opener, self._lease_owner = client, opener, lease_owner
        self._pose, self._settings, self._exercise, self._pace = pose, settings, exercise, pace
        self._link: Link | None = None
        self._reading: asyncio.Task[Any] | None = None
        self._scene: Scene | None = None
        self._pose_sequence = 0
        self._lost_place = False
        self.bytes_received = 0
        """Of mesh payloads, since the view was opened first."""

    @property
    def scene(self) -> Scene:
        """What is known of the view: mesh, sight lines, unsatisfied lines, last frame."""
        if self._scene is None:
            raise ConnectError("the view was never opened")
        return self._scene

    async def _open(self) -> None:
        settings, pose = self._settings.to_wire(), self._pose.to_wire()
        wish = scene_pb2.OpenView(
            exercise=self._exercise, settings=settings, pose=pose, lease_owner=self._lease_owner
        )
        if self._pace is not None:
            wish.pace.CopyFrom(self._pace.to_wire())
        link: Link | None = None
        try:
            link = await asyncio.wait_for(self._opener(wish), self._client.timeout_s)
            first = await asyncio.wait_for(link.read(), self._client.timeout_s)
        except (TimeoutError, asyncio.TimeoutError):
            if link is not None:
                await link.close()
            raise ConnectError(f"{self._client.address} did not open the view in time") from None
        if first.WhichOneof("response") != "opened":
            await link.close()
            raise ProtocolError("the first message of a view is not its opening")
        scene = Scene(first.opened, self._settings.triangles, bool(self._exercise))
        if self._scene is not None:
            scene.keep_mesh(self._scene)
        self._scene = scene
        self._link, self._pose_sequence, self._lost_place = link, 0, False

    async def _read(self) -> scene_pb2.StreamSceneResponse:
        if self._link is None:
            raise ConnectError("the view is closed")
        return await self._link.read()

    async def _send(self, **what: Any) -> None:
        if self._link is None:
            raise ConnectError("the view is closed")
        await self._link.send(scene_pb2.StreamSceneRequest(**what))

    def _steering(self) -> scene_pb2.SteerView:
        applied = self.scene.frame.sequence if self.scene.frame else 0
        return scene_pb2.SteerView(pose_sequence=self._pose_sequence, applied_sequence=applied)

    async def steer(self, pose: Pose, *, frame_time_ms: float = 0.0) -> int:
        """Moves the viewpoint; returns the pose's number, which the frame made for it carries.

        `frame_time_ms` says how long the last frame took to draw, for a target of a frame time.
        """
        self._pose = pose
        self._pose_sequence += 1
        wire = self._steering()
        wire.pose.CopyFrom(pose.to_wire())
        wire.frame_time_ms = frame_time_ms
        await self._send(steer=wire)
        return self._pose_sequence

    async def change(self, settings: Settings | None = None, *, pace: Pace | None = None) -> None:
        """Changes camera, target, subscription and regions, or the pace. Frames under way may still be of the old ones.

        What is not given stays as it is; ``Pace()`` ends a pace.
        """
        wire = self._steering()
        if settings is not None:
            self._settings = settings
            self.scene.max_triangles = max(self.scene.max_triangles, settings.triangles)
            wire.settings.CopyFrom(settings.to_wire())
        if pace is not None:
            self._pace = pace
            wire.pace.CopyFrom(pace.to_wire())
        await self._send(steer=wire)

    async def request_snapshot(self) -> None:
        """Asks for a frame that is based on nothing."""
        received = self.scene.frame.sequence if self.scene.frame else 0
        await self._send(snapshot=scene_pb2.RequestSnapshot(received_sequence=received))

    async def frame(self, timeout_s: float | None = 60.0) -> Frame:
        """Waits for the next frame, applies, checks and acknowledges it.

        A frame that does not fit is passed over, and a snapshot asked for. Raises :class:`TimeoutError` when none comes
        (one is due after a pose, new settings, an epoch, a snapshot asked for; losing none), and :class:`ConnectError`
        when the connection is lost: then the mesh is as it was, and :meth:`resume` goes on.
        """
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            message = await self._next_message(deadline)
            is_frame = message.WhichOneof("response") == "frame"
            if is_frame and self._lost_place and message.frame.base_sequence != 0:
                continue
            try:
                self.scene.apply(message)
            except ProtocolError:
                if not is_frame:
                    raise
                self._lost_place = True
                received = scene_pb2.RequestSnapshot(received_sequence=message.frame.sequence)
                await self._send(snapshot=received)
                continue
            if is_frame and self.scene.frame:
                self._lost_place = False
                self.bytes_received += self.scene.frame.payload_bytes
                with contextlib.suppress(SightlineError):  # the next call tells
                    await self._send(steer=self._steering())
                return self.scene.frame

    async def _next_message(self, deadline: float | None) -> Any:
        # A read that is cancelled takes the whole stream with it, so an unfinished one waits for the next call.
        if self._reading is None:
            self._reading = asyncio.ensure_future(self._read())
        left = None if deadline is None else max(0.0, deadline - time.monotonic())
        done, _ = await asyncio.wait({self._reading}, timeout=left)
        if not done:
            raise TimeoutError("no frame came in time")
        reading, self._reading = self._reading, None
        return reading.result()

    async def frame_of(self, pose_sequence: int, timeout_s: float | None = 60.0) -> Frame:
        """Waits for a frame that was made for this pose or a later one."""
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            left = None if deadline is None else max(0.0, deadline - time.monotonic())
            frame = await self.frame(left)
            if frame.pose_sequence >= pose_sequence:
                return frame

    async def resume(self, within_s: float = 30.0) -> None:
        """Opens the view anew, with its last pose, settings and pace, after the connection was lost.

        Tries until a server answers or `within_s` is over. The first frame after it is a snapshot; until it comes the mesh
        is the last one, if the server has the same terrain. Poses are numbered from 1 again. A server that was
        started anew may not have the exercise any more: then this raises :class:`Refused`, ``NOT_FOUND``.
        """
        await self.close()
        deadline = time.monotonic() + within_s
        while True:
            try:
                return await self._open()
            except ConnectError:
                if self._client._closed or time.monotonic() >= deadline:
                    raise
                await asyncio.sleep(0.1)

    async def close(self) -> None:
        """Ends the view. What was received stays readable."""
        link, self._link = self._link, None
        reading, self._reading = self._reading, None
        if link is not None:
            await link.close()
        if reading is not None:
            reading.cancel()
            await asyncio.gather(reading, return_exceptions=True)

    async def __aenter__(self) -> View:
        return self

    async def __aexit__(self, kind: type[BaseException] | None, error: object, trace: TracebackType | None) -> None:
        await self.close()


class Watch:
    """One stream that carries any number of views. Made by :meth:`Client.watch`; its views end with it.

    A process of many views has one stream this way, whatever its number; steering is then a call of its own. When the
    connection is lost, each view says so, and the first one that is resumed begins the stream anew.
    """

    def __init__(self, client: Client) -> None:
        self._client = client
        self._stream: WatchStream | None = None
        self._beginning = asyncio.Lock()
        self._closed = False

    async def _open(self, wish: scene_pb2.OpenView) -> Link:
        async with self._beginning:
            if self._closed:
                raise ConnectError("the watch is closed")
            if self._stream is None or self._stream.is_over:
                stream = WatchStream(self._client)
                await stream.begin()
                self._stream = stream
        return await self._stream.open(wish)

    async def view(
        self,
        pose: Pose,
        settings: Settings | None = None,
        *,
        exercise: str = "",
        pace: Pace | None = None,
        lease_owner: str = "",
    ) -> View:
        """Opens a view on this watch: see :meth:`Client.view`."""
        view = View(self._client, self._open, pose, settings or Settings(), exercise, pace, lease_owner)
        return await self._client._opened(view)

    async def close(self) -> None:
        """Ends the stream and its views. What these have received stays readable."""
        self._closed = True
        self._client._watches.discard(self)
        stream, self._stream = self._stream, None
        if stream is not None:
            await stream.close()

    async def __aenter__(self) -> Watch:
        return self

    async def __aexit__(self, kind: type[BaseException] | None, error: object, trace: TracebackType | None) -> None:
        await self.close()
