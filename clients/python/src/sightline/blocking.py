"""The client for programs without `asyncio`: the calls of :mod:`sightline.aio`, each waiting for its answer.

An event loop of its own runs in a thread, so this works in notebooks, too, where another loop runs.
"""

from __future__ import annotations

import asyncio
import functools
import threading
from collections.abc import AsyncGenerator, Callable, Coroutine, Generator, Iterable, Iterator
from types import TracebackType
from typing import Any, Concatenate, ParamSpec, TypeVar

import numpy as np
import numpy.typing as npt

from . import aio
from .camera import Pace, Pose, Settings
from .errors import Refused
from .scene import Scene
from .types import Altitude, Frame, LinesOfSight, Precision, VerdictNews

P = ParamSpec("P")
R = TypeVar("R")


class _Loop:
    """An event loop in a thread, for all connections: grpc polls for one loop a process, and complains of more."""

    _shared: _Loop | None = None
    _lock = threading.Lock()

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._loop.set_exception_handler(_unless_grpc_polls)
        threading.Thread(target=self._loop.run_forever, name="sightline", daemon=True).start()

    @classmethod
    def shared(cls) -> _Loop:
        with cls._lock:
            if cls._shared is None:
                cls._shared = cls()
            return cls._shared

    def run(self, coroutine: Coroutine[Any, Any, R]) -> R:
        future = asyncio.run_coroutine_threadsafe(coroutine, self._loop)
        try:
            return future.result()
        except BaseException:
            future.cancel()  # an interrupt from the keyboard; without effect on a future that is done
            raise

    def start(self, coroutine: Coroutine[Any, Any, None]) -> None:
        """Runs it without waiting."""
        asyncio.run_coroutine_threadsafe(coroutine, self._loop)


def _unless_grpc_polls(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    # Where a program has a loop of its own, too, grpc may find its wake-up already read by the other: harmless.
    if not isinstance(context.get("exception"), BlockingIOError):
        loop.default_exception_handler(context)


def _client(method: Callable[Concatenate[aio.Client, P], Coroutine[Any, Any, R]]) -> Callable[Concatenate[Client, P], R]:
    @functools.wraps(method)
    def call(self: Client, /, *args: P.args, **kwargs: P.kwargs) -> R:
        return self._loop.run(method(self._client, *args, **kwargs))

    return call


def _view(method: Callable[Concatenate[aio.View, P], Coroutine[Any, Any, R]]) -> Callable[Concatenate[View, P], R]:
    @functools.wraps(method)
    def call(self: View, /, *args: P.args, **kwargs: P.kwargs) -> R:
        return self._loop.run(method(self._view, *args, **kwargs))

    return call


async def _closed(watch: AsyncGenerator[Any, None]) -> None:
    await watch.aclose()


def connect(
    address: str, *, access: aio.Access | None = None, timeout_s: float = 60.0, connect_timeout_s: float = 10.0
) -> Client:
    """Connects to the server at `address`, such as ``"127.0.0.1:7410"``, or ``"https://host:7410"`` for TLS.

    `timeout_s` is the deadline of each call but the streams. Raises :class:`ConnectError` when nothing answers, or when
    certificates do not fit.
    """
    loop = _Loop.shared()
    connecting = aio.connect(address, access=access, timeout_s=timeout_s, connect_timeout_s=connect_timeout_s)
    return Client(loop, loop.run(connecting))


class Client:
    """A connection to a server. Made by :func:`connect`; the calls are those of :class:`sightline.aio.Client`."""

    def __init__(self, loop: _Loop, client: aio.Client) -> None:
        self._loop = loop
        self._client = client

    status = _client(aio.Client.status)
    terrain = _client(aio.Client.terrain)
    heights = _client(aio.Client.heights)
    line_of_sight = _client(aio.Client.line_of_sight)
    lines_of_sight = _client(aio.Client.lines_of_sight)
    ray = _client(aio.Client.ray)
    horizon = _client(aio.Client.horizon)
    profile = _client(aio.Client.profile)
    viewshed = _client(aio.Client.viewshed)
    intervisibility = _client(aio.Client.intervisibility)
    create_exercise = _client(aio.Client.create_exercise)
    exercises = _client(aio.Client.exercises)
    exercise = _client(aio.Client.exercise)
    change_exercise = _client(aio.Client.change_exercise)
    delete_exercise = _client(aio.Client.delete_exercise)
    renew_lease = _client(aio.Client.renew_lease)

    def watch_exercise(
        self, name: str, *, lines: Iterable[int] = (), lease_owner: str = ""
    ) -> Generator[VerdictNews, None, None]:
        """The verdicts of an exercise as they change: see :meth:`sightline.aio.Client.watch_exercise`.

        Closing the generator ends the watch.
        """
        watch = self._client.watch_exercise(name, lines=lines, lease_owner=lease_owner)

        async def following() -> VerdictNews | None:
            return await anext(watch, None)

        try:
            while (news := self._loop.run(following())) is not None:
                yield news
        finally:
            # Perhaps by the garbage collector, which runs in any thread, that of the loop included.
            self._loop.start(_closed(watch))

    def stream_lines_of_sight(
        self,
        groups: Iterable[aio.LineGroup],
        *,
        frame: Frame = "map",
        altitude: Altitude = "absolute",
        strict: bool = False,
        precision: Precision | float = "exact",
    ) -> Iterator[tuple[npt.NDArray[np.uint64], LinesOfSight | Refused]]:
        """Many groups of lines at once: see :meth:`sightline.aio.Client.stream_lines_of_sight`.

        `groups` is read in another thread, as the server has room.
        """
        answers = self._client.stream_lines_of_sight(
            groups, frame=frame, altitude=altitude, strict=strict, precision=precision
        )

        async def following() -> tuple[npt.NDArray[np.uint64], LinesOfSight | Refused] | None:
            return await anext(answers, None)

        while (answer := self._loop.run(following())) is not None:
            yield answer

    def view(
        self,
        pose: Pose,
        settings: Settings | None = None,
        *,
        exercise: str = "",
        pace: Pace | None = None,
        lease_owner: str = "",
    ) -> View:
        """Opens a view on a stream of its own: see :meth:`sightline.aio.Client.view`."""
        opening = self._client.view(pose, settings, exercise=exercise, pace=pace, lease_owner=lease_owner)
        return View(self._loop, self._loop.run(opening))

    def watch(self) -> Watch:
        """One stream for any number of views (:meth:`Watch.view`); it begins with the first."""
        return Watch(self._loop, self._client.watch())

    def close(self) -> None:
        """Closes the connection, its views and watches."""
        self._loop.run(self._client.close())

    def __enter__(self) -> Client:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: object, trace: TracebackType | None) -> None:
        self.close()


class Watch:
    """One stream that carries any number of views. Made by :meth:`Client.watch`; see :class:`sightline.aio.Watch`."""

    def __init__(self, loop: _Loop, watch: aio.Watch) -> None:
        self._loop = loop
        self._watch = watch

    def view(
        self,
        pose: Pose,
        settings: Settings | None = None,
        *,
        exercise: str = "",
        pace: Pace | None = None,
        lease_owner: str = "",
    ) -> View:
        """Opens a view on this watch: see :meth:`sightline.aio.Client.view`."""
        opening = self._watch.view(pose, settings, exercise=exercise, pace=pace, lease_owner=lease_owner)
        return View(self._loop, self._loop.run(opening))

    def close(self) -> None:
        """Ends the stream and its views. What these have received stays readable."""
        self._loop.run(self._watch.close())

    def __enter__(self) -> Watch:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: object, trace: TracebackType | None) -> None:
        self.close()


class View:
    """One view. Made by :meth:`Client.view` and :meth:`Watch.view`; the calls are those of :class:`sightline.aio.View`."""

    def __init__(self, loop: _Loop, view: aio.View) -> None:
        self._loop = loop
        self._view = view

    @property
    def scene(self) -> Scene:
        """What is known of the view: mesh, sight lines, unsatisfied lines, last frame."""
        return self._view.scene

    @property
    def bytes_received(self) -> int:
        """Of mesh payloads, since the view was opened first."""
        return self._view.bytes_received

    steer = _view(aio.View.steer)
    change = _view(aio.View.change)
    request_snapshot = _view(aio.View.request_snapshot)
    frame = _view(aio.View.frame)
    frame_of = _view(aio.View.frame_of)
    resume = _view(aio.View.resume)
    close = _view(aio.View.close)

    def __enter__(self) -> View:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: object, trace: TracebackType | None) -> None:
        self.close()
