"""The client for `asyncio`. :mod:`sightline.blocking` offers the same calls without it.

    async with await sightline.aio.connect("127.0.0.1:7410") as server:
        answer = await server.line_of_sight((500, 400, 2), (900, 700, 2), altitude="agl")
"""

from __future__ import annotations

import asyncio
import weakref
from collections.abc import AsyncGenerator, AsyncIterable, AsyncIterator, Awaitable, Iterable
from types import TracebackType
from typing import Any, TypeVar

import grpc
import grpc.aio
import numpy as np
import numpy.typing as npt

from . import channel as channels
from . import convert
from .camera import Pace, Pose, Settings
from .channel import MAX_MESSAGE_BYTES, Access, translated
from .errors import ConnectError, ProtocolError, Refused
from .links import StreamLink
from .types import (
    Altitude,
    Entity,
    Exercise,
    ExerciseSummary,
    Frame,
    Heights,
    Horizon,
    Lease,
    LineOfSight,
    LinesOfSight,
    Point,
    Precision,
    Profile,
    Ray,
    SightLine,
    Status,
    Terrain,
    VerdictNews,
    Verdicts,
    Viewshed,
)
from .v1 import (
    exercise_pb2,
    exercise_pb2_grpc,
    line_of_sight_pb2,
    line_of_sight_pb2_grpc,
    operation_pb2,
    operation_pb2_grpc,
    scene_pb2,
    scene_pb2_grpc,
    terrain_pb2,
    terrain_pb2_grpc,
)
from .views import View, Watch

BATCH_LINES = 100_000
"""Lines of a batch that are asked in one call; more are asked in several."""

_T = TypeVar("_T")


async def connect(
    address: str, *, access: Access | None = None, timeout_s: float = 60.0, connect_timeout_s: float = 10.0
) -> Client:
    """Connects to the server at `address`, such as ``"127.0.0.1:7410"``, or ``"https://host:7410"`` for TLS.

    `timeout_s` is the deadline of each call but the streams. Raises :class:`ConnectError` when nothing answers, or when
    certificates do not fit.
    """
    access = access or Access()
    channel = channels.make(address, access)
    failed = ConnectError(f"cannot connect to {address}; is a Sightline server running there, and do certificates fit?")
    try:
        await asyncio.wait_for(channels.ready(channel, failed), connect_timeout_s)
    except (TimeoutError, asyncio.TimeoutError):
        await channel.close(None)
        raise failed from None
    except BaseException:
        await channel.close(None)
        raise
    return Client(channel, address, timeout_s, access.token)


LineGroup = tuple[npt.ArrayLike, npt.ArrayLike, npt.ArrayLike]
"""Ids, observers and targets of a group of lines."""


async def _each(items: Iterable[_T] | AsyncIterable[_T]) -> AsyncIterator[_T]:
    if isinstance(items, AsyncIterable):
        async for item in items:
            yield item
    else:
        for item in items:
            yield item


class Client:
    """A connection to a server. Made by :func:`connect`."""

    def __init__(self, channel: grpc.aio.Channel, address: str, timeout_s: float, token: str | None) -> None:
        self._channel = channel
        self._closed = False
        self._views: weakref.WeakSet[View] = weakref.WeakSet()
        self._watches: set[Watch] = set()
        self._metadata = [("authorization", f"Bearer {token}")] if token else []
        self.address = address
        self.timeout_s = timeout_s
        self._terrains = terrain_pb2_grpc.TerrainServiceStub(channel)  # type: ignore[no-untyped-call]
        self._lines = line_of_sight_pb2_grpc.LineOfSightServiceStub(channel)  # type: ignore[no-untyped-call]
        self._exercises = exercise_pb2_grpc.ExerciseServiceStub(channel)  # type: ignore[no-untyped-call]
        self._scenes = scene_pb2_grpc.SceneServiceStub(channel)  # type: ignore[no-untyped-call]
        self._operation = operation_pb2_grpc.OperationServiceStub(channel)  # type: ignore[no-untyped-call]

    async def close(self) -> None:
        """Closes the connection, its views and watches. Calls after it raise :class:`ConnectError`."""
        self._closed = True
        for view in list(self._views):
            await view.close()
        for watch in list(self._watches):
            await watch.close()
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
            raise translated(error, self.address) from None

    async def _all(self, call: AsyncIterable[_T]) -> list[_T]:
        try:
            return [message async for message in call]
        except grpc.RpcError as error:
            raise translated(error, self.address) from None

    # --- server and terrain

    async def status(self) -> Status:
        """How the server is; where it wants tokens, one with the role ``administer``."""
        request = operation_pb2.GetStatusRequest()
        return convert.status(await self._one(self._operation.GetStatus(request, **self._call())))

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
            raise translated(error, self.address) from None

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

    async def create_exercise(self, name: str, *, lease: Lease | None = None) -> None:
        """Makes an exercise, at epoch 0; it goes when the `lease` has run out."""
        request = exercise_pb2.CreateExerciseRequest(name=name, lease=convert.lease(lease))
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
        lease: Lease | None = None,
    ) -> int:
        """Changes an exercise, all of it in one epoch or nothing; returns the epoch. What is put goes with the `lease`."""
        request = exercise_pb2.ChangeExerciseRequest(
            name=name,
            remove_entities=remove_entities,
            remove_sight_lines=remove_lines,
            put_entities=map(convert.entity, put_entities),
            put_sight_lines=map(convert.sight_line, put_lines),
            lease=convert.lease(lease),
        )
        return int((await self._one(self._exercises.ChangeExercise(request, **self._call()))).epoch)

    async def delete_exercise(self, name: str) -> None:
        """Ends an exercise and every view of it."""
        request = exercise_pb2.DeleteExerciseRequest(name=name)
        await self._one(self._exercises.DeleteExercise(request, **self._call()))

    async def renew_lease(self, name: str, owner: str) -> int:
        """Gives the lease of `owner` in an exercise its full term again; returns that in seconds.

        Raises :class:`Refused`, ``NOT_FOUND``, when it has run out or nothing is under it.
        """
        request = exercise_pb2.RenewLeaseRequest(name=name, owner=owner)
        return int((await self._one(self._exercises.RenewLease(request, **self._call()))).term_s)

    async def watch_exercise(
        self, name: str, *, lines: Iterable[int] = (), lease_owner: str = ""
    ) -> AsyncGenerator[VerdictNews, None]:
        """The verdicts of an exercise as they change: all of them at first, then those that are others than before.

        Who reads slowly is told the newest state. `lines` are those to watch (none: all); the lease of `lease_owner` does
        not run meanwhile. Raises :class:`Refused`, ``NOT_FOUND``, when the exercise has ended.
        """
        request = exercise_pb2.WatchExerciseRequest(name=name, sight_lines=lines, lease_owner=lease_owner)
        call = self._exercises.WatchExercise(request, **self._call() | {"timeout": None})
        try:
            async for news in call:
                yield convert.verdict_news(news)
        except grpc.RpcError as error:
            raise translated(error, self.address) from None
        finally:
            call.cancel()

    # --- views

    async def view(
        self,
        pose: Pose,
        settings: Settings | None = None,
        *,
        exercise: str = "",
        pace: Pace | None = None,
        lease_owner: str = "",
    ) -> View:
        """Opens a view of `exercise` (empty: of the terrain alone) on a stream of its own.

        It holds the lease of `lease_owner` in that exercise while it is open.
        """

        def opener(wish: scene_pb2.OpenView) -> Awaitable[StreamLink]:
            return StreamLink.open(self, wish)

        return await self._opened(View(self, opener, pose, settings or Settings(), exercise, pace, lease_owner))

    def watch(self) -> Watch:
        """One stream for any number of views (:meth:`Watch.view`); it begins with the first."""
        watch = Watch(self)
        self._watches.add(watch)
        return watch

    async def _opened(self, view: View) -> View:
        await view._open()
        self._views.add(view)
        return view


__all__ = ["BATCH_LINES", "MAX_MESSAGE_BYTES", "Access", "Client", "View", "Watch", "connect"]
