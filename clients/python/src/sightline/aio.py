"""The client for `asyncio`. :mod:`sightline.blocking` offers the same calls without it.

    async with await sightline.aio.connect("127.0.0.1:7410") as server:
        answer = await server.line_of_sight((500, 400, 2), (900, 700, 2), altitude="agl")
"""

from __future__ import annotations

import asyncio
import contextlib
import time
import weakref
from collections.abc import AsyncIterable, AsyncIterator, Awaitable, Iterable
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, TypeVar

import grpc
import grpc.aio
import numpy as np
import numpy.typing as npt

from . import convert
from .camera import Pose, Settings
from .errors import ConnectError, DeadlineExceeded, ProtocolError, Refused, SightlineError
from .scene import Frame as SceneFrame
from .scene import Scene
from .types import (
    Altitude,
    Entity,
    Exercise,
    ExerciseSummary,
    Frame,
    Heights,
    Horizon,
    LineOfSight,
    LinesOfSight,
    Point,
    Precision,
    Profile,
    Ray,
    SightLine,
    Terrain,
    Verdicts,
    Viewshed,
)
from .v1 import (
    exercise_pb2,
    exercise_pb2_grpc,
    line_of_sight_pb2,
    line_of_sight_pb2_grpc,
    scene_pb2,
    scene_pb2_grpc,
    terrain_pb2,
    terrain_pb2_grpc,
)

MAX_MESSAGE_BYTES = 64 << 20
"""Greatest size of a message that a client accepts: a snapshot of millions of triangles fits."""
BATCH_LINES = 100_000
"""Lines of a batch that are asked in one call; more are asked in several."""

_CHANNEL_OPTIONS = [
    ("grpc.max_receive_message_length", MAX_MESSAGE_BYTES),
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.max_reconnect_backoff_ms", 1000),
]
_T = TypeVar("_T")


def _translated(error: grpc.RpcError, address: str) -> SightlineError:
    """The error of this package for one of grpc's."""
    return _refusal(error.code(), error.details() or "", address)


def _refusal(code: grpc.StatusCode, details: str, address: str) -> SightlineError:
    if code is grpc.StatusCode.UNAVAILABLE:
        return ConnectError(f"no connection to {address}: {details}")
    if code is grpc.StatusCode.DEADLINE_EXCEEDED:
        return DeadlineExceeded(code.name, details)
    return Refused(code.name, details)


@dataclass(frozen=True)
class Access:
    """What a client trusts, and who it is."""

    authorities: bytes | None = None
    """The authorities one of which must have signed the server's certificate, PEM; None: those that the system trusts."""
    identity: tuple[bytes, bytes] | None = field(default=None, repr=False)
    """This client's certificate and its key, PEM, for servers that ask for one."""
    token: str | None = field(default=None, repr=False)
    """The secret of this client's token."""


async def connect(
    address: str, *, access: Access | None = None, timeout_s: float = 60.0, connect_timeout_s: float = 10.0
) -> Client:
    """Connects to the server at `address`, such as ``"127.0.0.1:7410"``, or ``"https://host:7410"`` for TLS.

    `timeout_s` is the deadline of each call but the streams. Raises :class:`ConnectError` when nothing answers, or when
    certificates do not fit.
    """
    access = access or Access()
    channel = _channel(address, access)
    failed = ConnectError(f"cannot connect to {address}; is a Sightline server running there, and do certificates fit?")
    try:
        await asyncio.wait_for(_ready(channel, failed), connect_timeout_s)
    except (TimeoutError, asyncio.TimeoutError):
        await channel.close(None)
        raise failed from None
    except BaseException:
        await channel.close(None)
        raise
    return Client(channel, address, timeout_s, access.token)


def _channel(address: str, access: Access) -> grpc.aio.Channel:
    if not address.startswith("https://"):
        return grpc.aio.insecure_channel(address.removeprefix("http://"), options=_CHANNEL_OPTIONS)
    certificate, key = access.identity or (None, None)
    credentials = grpc.ssl_channel_credentials(access.authorities, key, certificate)
    return grpc.aio.secure_channel(address.removeprefix("https://"), credentials, options=_CHANNEL_OPTIONS)


LineGroup = tuple[npt.ArrayLike, npt.ArrayLike, npt.ArrayLike]
"""Ids, observers and targets of a group of lines."""


async def _each(items: Iterable[_T] | AsyncIterable[_T]) -> AsyncIterator[_T]:
    if isinstance(items, AsyncIterable):
        async for item in items:
            yield item
    else:
        for item in items:
            yield item


async def _ready(channel: grpc.aio.Channel, failed: ConnectError) -> None:
    while (state := channel.get_state(try_to_connect=True)) is not grpc.ChannelConnectivity.READY:
        if state is grpc.ChannelConnectivity.TRANSIENT_FAILURE:
            raise failed
        await channel.wait_for_state_change(state)


class Client:
    """A connection to a server. Made by :func:`connect`."""

    def __init__(self, channel: grpc.aio.Channel, address: str, timeout_s: float, token: str | None) -> None:
        self._channel = channel
        self._closed = False
        self._views: weakref.WeakSet[View] = weakref.WeakSet()
        self._metadata = [("authorization", f"Bearer {token}")] if token else []
        self.address = address
        self.timeout_s = timeout_s
        self._terrains = terrain_pb2_grpc.TerrainServiceStub(channel)  # type: ignore[no-untyped-call]
        self._lines = line_of_sight_pb2_grpc.LineOfSightServiceStub(channel)  # type: ignore[no-untyped-call]
        self._exercises = exercise_pb2_grpc.ExerciseServiceStub(channel)  # type: ignore[no-untyped-call]
        self._scenes = scene_pb2_grpc.SceneServiceStub(channel)  # type: ignore[no-untyped-call]

    async def close(self) -> None:
        """Closes the connection and its views. Calls after it raise :class:`ConnectError`."""
        self._closed = True
        for view in list(self._views):
            await view.close()
        await self._channel.close(None)

    async def __aenter__(self) -> Client:
        return self

    async def __aexit__(self, kind: type[BaseException] | None, error: object, trace: TracebackType | None) -> None:
        await self.close()

    def _call(self) -> dict[str, Any]:
        if self._closed:
            raise ConnectError(f"the connection to {self.address} is closed")
        return {"timeout": self.timeout_s, "metadata": self._metadata}

    async def _one(self, call: Awaitable[_T]) -> _T:
        try:
            return await call
        except grpc.RpcError as error:
            raise _translated(error, self.address) from None

    async def _all(self, call: AsyncIterable[_T]) -> list[_T]:
        try:
            return [message async for message in call]
        except grpc.RpcError as error:
            raise _translated(error, self.address) from None

    # --- terrain

    async def terrain(self) -> Terrain:
        """The terrain that the server holds."""
        call = self._terrains.DescribeTerrain(terrain_pb2.DescribeTerrainRequest(), **self._call())
        return convert.terrain((await self._one(call)).terrain)

    async def heights(self, points: npt.ArrayLike, *, frame: Frame = "map", normals: bool = False) -> Heights:
        """Exact heights of the ground at `points`, (n, 2) in `frame`."""
        xy = convert.columns(points, 2)
        request = terrain_pb2.GetHeightsRequest(frame=convert.frame(frame), normals=normals)
        request.x.extend(xy[:, 0].tolist())
        request.y.extend(xy[:, 1].tolist())
        found = await self._one(self._terrains.GetHeights(request, **self._call()))
        if len(found.z) != len(xy):
            raise ProtocolError(f"{len(found.z)} heights at {len(xy)} points")
        return convert.heights(found, normals)

    # --- lines of sight

    async def line_of_sight(
        self,
        a: Point,
        b: Point,
        *,
        frame: Frame = "map",
        altitude: Altitude = "absolute",
        strict: bool = False,
        derive: bool = False,
        stretches: bool = False,
        precision: Precision | float = "exact",
        earth_radius_m: float | None = None,
    ) -> LineOfSight:
        """Whether observer `a` sees target `b`, exactly.

        With `strict`, mere contact blocks; with `derive`, the answer has obstruction, clearance and least target height,
        with `stretches` what lies above and below ground along the line, and which ground under it is seen.
        `precision` as a number is a tolerance in height units. `earth_radius_m` puts a sphere under the line.
        """
        request = line_of_sight_pb2.QueryLineOfSightRequest(
            a=convert.end(a, frame, altitude),
            b=convert.end(b, frame, altitude),
            strict=strict,
            derive=derive,
            stretches=stretches,
            options=convert.options(precision, earth_radius_m),
        )
        return convert.line_of_sight(await self._one(self._lines.QueryLineOfSight(request, **self._call())))

    async def lines_of_sight(
        self,
        a: npt.ArrayLike,
        b: npt.ArrayLike,
        *,
        frame: Frame = "map",
        altitude: Altitude = "absolute",
        strict: bool = False,
        precision: Precision | float = "exact",
        earth_radius_m: float | None = None,
    ) -> LinesOfSight:
        """Many lines at once: observers `a` and targets `b`, (n, 3) each or (1, 3) for one that is common to all."""
        starts, ends = np.broadcast_arrays(convert.columns(a, 3), convert.columns(b, 3))
        how = convert.options(precision, earth_radius_m)
        parts: list[LinesOfSight] = []
        for at in range(0, len(starts), BATCH_LINES):
            some = slice(at, at + BATCH_LINES)
            request = convert.batch(starts[some], ends[some], frame, altitude, strict, how)
            chunks = await self._all(self._lines.QueryLineOfSightBatch(request, **self._call()))
            parts.append(convert.lines_of_sight(chunks, len(request.ax)))
        if not parts:
            return LinesOfSight(np.zeros(0, np.int8), np.zeros(0, np.bool_), np.zeros(0, np.bool_))
        columns = ((p.verdicts, p.grazes, p.certain) for p in parts)
        verdicts, grazes, certain = (np.concatenate(column) for column in zip(*columns, strict=True))
        return LinesOfSight(verdicts, grazes, certain)

    async def stream_lines_of_sight(
        self,
        groups: Iterable[LineGroup] | AsyncIterable[LineGroup],
        *,
        frame: Frame = "map",
        altitude: Altitude = "absolute",
        strict: bool = False,
        precision: Precision | float = "exact",
    ) -> AsyncIterator[tuple[npt.NDArray[np.uint64], LinesOfSight | Refused]]:
        """Questions as they arise: groups of (ids, observers, targets), arrays of (n,), (n, 3) and (n, 3), n to 10,000.

        Answers come with the ids of their group as they are ready, in any order. A group that the server refuses comes
        with the reason, and the stream goes on.
        """
        how = convert.options(precision)

        async def asked() -> AsyncIterator[line_of_sight_pb2.StreamLinesOfSightRequest]:
            async for ids, a, b in _each(groups):
                starts, ends = np.broadcast_arrays(convert.columns(a, 3), convert.columns(b, 3))
                lines = convert.batch(starts, ends, frame, altitude, strict, how)
                numbers = np.asarray(ids, dtype=np.uint64).tolist()
                yield line_of_sight_pb2.StreamLinesOfSightRequest(ids=numbers, lines=lines)

        try:
            async for answer in self._lines.StreamLinesOfSight(asked(), **self._call() | {"timeout": None}):
                yield convert.group(answer)
        except grpc.RpcError as error:
            raise _translated(error, self.address) from None

    async def ray(
        self,
        start: Point,
        azimuth_deg: float,
        elevation_deg: float,
        range_m: float,
        *,
        frame: Frame = "map",
        altitude: Altitude = "absolute",
        earth_radius_m: float | None = None,
    ) -> Ray:
        """The first ground in a direction: azimuth clockwise from grid north, elevation above the horizontal."""
        request = line_of_sight_pb2.QueryRayRequest(
            azimuth_deg=azimuth_deg,
            elevation_deg=elevation_deg,
            range_m=range_m,
            options=convert.options("exact", earth_radius_m),
        )
        getattr(request, "from").CopyFrom(convert.end(start, frame, altitude))
        return convert.ray(await self._one(self._lines.QueryRay(request, **self._call())))

    async def horizon(
        self,
        observer: Point,
        azimuths_deg: npt.ArrayLike,
        range_m: float,
        *,
        frame: Frame = "map",
        altitude: Altitude = "absolute",
        earth_radius_m: float | None = None,
    ) -> Horizon:
        """How high the ground stands around an observer, azimuth by azimuth, within `range_m`."""
        azimuths = np.atleast_1d(np.asarray(azimuths_deg, dtype=np.float64))
        options = convert.options("exact", earth_radius_m)
        request = line_of_sight_pb2.QueryHorizonRequest(range_m=range_m, options=options)
        getattr(request, "from").CopyFrom(convert.end(observer, frame, altitude))
        request.azimuths_deg.extend(azimuths.tolist())
        return convert.horizon(await self._one(self._lines.QueryHorizon(request, **self._call())), azimuths)

    async def profile(
        self, a: npt.ArrayLike, b: npt.ArrayLike, *, frame: Frame = "map", earth_radius_m: float | None = None
    ) -> Profile:
        """Every vertex of the ground under the line from `a` to `b`, plan positions (2,) in `frame`."""
        ends = convert.columns(np.stack([np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)]), 2)
        (ax, ay), (bx, by) = ends.tolist()
        options = convert.options("exact", earth_radius_m)
        request = line_of_sight_pb2.QueryProfileRequest(
            frame=convert.frame(frame), ax=ax, ay=ay, bx=bx, by=by, options=options
        )
        return convert.profile(await self._one(self._lines.QueryProfile(request, **self._call())))

    async def viewshed(
        self,
        observer: Point,
        *,
        radius_m: float | None = None,
        rectangle: tuple[int, int, int, int] | None = None,
        target_height_m: float = 0.0,
        frame: Frame = "map",
        altitude: Altitude = "absolute",
        strict: bool = False,
        earth_radius_m: float | None = None,
    ) -> Viewshed:
        """The exact verdict for each post within `radius_m` of `observer`, or of a rectangle of posts.

        `rectangle` is first column, last column, first row, last row, all included. Targets stand `target_height_m`
        above their posts.
        """
        request = line_of_sight_pb2.QueryViewshedRequest(
            observer=convert.end(observer, frame, altitude),
            target_height_m=target_height_m,
            strict=strict,
            options=convert.options("exact", earth_radius_m),
        )
        if (radius_m is None) == (rectangle is None):
            raise ValueError("a viewshed needs either radius_m or rectangle")
        if radius_m is not None:
            request.radius_m = radius_m
        elif rectangle is not None:
            sides = zip(("first_i", "last_i", "first_j", "last_j"), rectangle, strict=True)
            request.rectangle.CopyFrom(line_of_sight_pb2.PostRectangle(**dict(sides)))
        ground = await self.terrain()
        return convert.viewshed(await self._all(self._lines.QueryViewshed(request, **self._call())), ground)

    async def intervisibility(
        self,
        points: npt.ArrayLike,
        *,
        frame: Frame = "map",
        altitude: Altitude = "absolute",
        strict: bool = False,
        earth_radius_m: float | None = None,
    ) -> Verdicts:
        """Which of `points`, (n, 3), see each other: a symmetric (n, n) matrix of verdicts, 0 on the diagonal."""
        xyz = convert.columns(points, 3)
        request = line_of_sight_pb2.QueryIntervisibilityRequest(
            frame=convert.frame(frame),
            altitude=convert.altitude(altitude),
            strict=strict,
            options=convert.options("exact", earth_radius_m),
        )
        for name, values in zip("xyz", xyz.T, strict=True):
            getattr(request, name).extend(values.tolist())
        rows = await self._all(self._lines.QueryIntervisibility(request, **self._call()))
        return convert.intervisibility(rows, len(xyz))

    # --- exercises

    async def create_exercise(self, name: str) -> None:
        """Makes an exercise, at epoch 0."""
        request = exercise_pb2.CreateExerciseRequest(name=name)
        await self._one(self._exercises.CreateExercise(request, **self._call()))

    async def exercises(self) -> list[ExerciseSummary]:
        """The outlines of all exercises, by name."""
        request = exercise_pb2.ListExercisesRequest()
        found = await self._one(self._exercises.ListExercises(request, **self._call()))
        return [ExerciseSummary(e.name, e.epoch, e.entities, e.sight_lines) for e in found.exercises]

    async def exercise(self, name: str) -> Exercise:
        """An exercise at its present epoch: entities, resolved sight lines, exact verdicts."""
        request = exercise_pb2.GetExerciseRequest(name=name)
        return convert.exercise(name, await self._one(self._exercises.GetExercise(request, **self._call())))

    async def change_exercise(
        self,
        name: str,
        *,
        put_entities: Iterable[Entity] = (),
        put_lines: Iterable[SightLine] = (),
        remove_entities: Iterable[int] = (),
        remove_lines: Iterable[int] = (),
    ) -> int:
        """Changes an exercise, all of it in one epoch or nothing; returns the epoch."""
        request = exercise_pb2.ChangeExerciseRequest(
            name=name,
            remove_entities=remove_entities,
            remove_sight_lines=remove_lines,
            put_entities=map(convert.entity, put_entities),
            put_sight_lines=map(convert.sight_line, put_lines),
        )
        return int((await self._one(self._exercises.ChangeExercise(request, **self._call()))).epoch)

    async def delete_exercise(self, name: str) -> None:
        """Ends an exercise and every view of it."""
        request = exercise_pb2.DeleteExerciseRequest(name=name)
        await self._one(self._exercises.DeleteExercise(request, **self._call()))

    # --- views

    async def view(self, pose: Pose, settings: Settings | None = None, *, exercise: str = "") -> View:
        """Opens a view of `exercise` (empty: of the terrain alone)."""
        view = View(self, pose, settings or Settings(), exercise)
        await view._open()
        self._views.add(view)
        return view


class View:
    """One view over its stream: steers, receives, checks, acknowledges. Made by :meth:`Client.view`.

    Close it, or use it in ``async with``. Its state is that after the last frame: see :class:`sightline.Scene`.
    """

    def __init__(self, client: Client, pose: Pose, settings: Settings, exercise: str) -> None:
        self._client = client
        self._pose, self._settings, self._exercise = pose, settings, exercise
        self._call: grpc.aio.StreamStreamCall[Any, Any] | None = None
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
        wire = scene_pb2.OpenView(
            exercise=self._exercise, settings=self._settings.to_wire(), pose=self._pose.to_wire()
        )
        call = self._client._scenes.StreamScene(**self._client._call() | {"timeout": None})
        self._call, self._pose_sequence, self._lost_place = call, 0, False
        try:
            await asyncio.wait_for(call.write(scene_pb2.StreamSceneRequest(open=wire)), self._client.timeout_s)
            first = await asyncio.wait_for(self._read(), self._client.timeout_s)
        except asyncio.InvalidStateError:
            raise await self._reason() from None
        except grpc.RpcError as error:
            raise _translated(error, self._client.address) from None
        except (TimeoutError, asyncio.TimeoutError):
            call.cancel()
            raise ConnectError(f"{self._client.address} did not open the view in time") from None
        if first.WhichOneof("response") != "opened":
            call.cancel()
            raise ProtocolError("the first message of a view is not its opening")
        self._scene = Scene(first.opened, self._settings.triangles, bool(self._exercise))

    async def _reason(self) -> SightlineError:
        """Why the stream is over."""
        if self._call is None:
            return ConnectError("the view is closed")
        code, details = await self._call.code(), await self._call.details()
        if code is grpc.StatusCode.OK:
            return ConnectError(f"{self._client.address} has closed the view")
        return _refusal(code, details or "", self._client.address)

    async def _read(self) -> Any:
        if self._call is None:
            raise ConnectError("the view is closed")
        message = await self._call.read()
        if message is grpc.aio.EOF:  # type: ignore[attr-defined]
            raise await self._reason()
        return message

    async def _send(self, **what: Any) -> None:
        if self._call is None:
            raise ConnectError("the view is closed")
        try:
            await self._call.write(scene_pb2.StreamSceneRequest(**what))
        except asyncio.InvalidStateError:
            raise await self._reason() from None
        except grpc.RpcError as error:
            raise _translated(error, self._client.address) from None

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

    async def change(self, settings: Settings) -> None:
        """Changes camera, target and subscription. Frames under way may still be of the old ones."""
        self._settings = settings
        self.scene.max_triangles = max(self.scene.max_triangles, settings.triangles)
        wire = self._steering()
        wire.settings.CopyFrom(settings.to_wire())
        await self._send(steer=wire)

    async def request_snapshot(self) -> None:
        """Asks for a frame that is based on nothing."""
        received = self.scene.frame.sequence if self.scene.frame else 0
        await self._send(snapshot=scene_pb2.RequestSnapshot(received_sequence=received))

    async def frame(self, timeout_s: float | None = 60.0) -> SceneFrame:
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
        try:
            return reading.result()
        except grpc.RpcError as error:
            raise _translated(error, self._client.address) from None

    async def frame_of(self, pose_sequence: int, timeout_s: float | None = 60.0) -> SceneFrame:
        """Waits for a frame that was made for this pose or a later one."""
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            left = None if deadline is None else max(0.0, deadline - time.monotonic())
            frame = await self.frame(left)
            if frame.pose_sequence >= pose_sequence:
                return frame

    async def resume(self, within_s: float = 30.0) -> None:
        """Opens the view anew, with its last pose and settings, after the connection was lost.

        Tries until a server answers or `within_s` is over. The first frame after it is a snapshot. A server that was
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
        call, self._call = self._call, None
        reading, self._reading = self._reading, None
        if call is not None:
            call.cancel()
        if reading is not None:
            reading.cancel()
            await asyncio.gather(reading, return_exceptions=True)

    async def __aenter__(self) -> View:
        return self

    async def __aexit__(self, kind: type[BaseException] | None, error: object, trace: TracebackType | None) -> None:
        await self.close()


__all__ = ["BATCH_LINES", "MAX_MESSAGE_BYTES", "Client", "View", "connect"]
