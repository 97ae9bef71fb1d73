"""What carries a view: a stream of its own, or a watch, one server stream that carries any number of views.

Both read the messages of one view in order and send its wishes; a view does not know which one it has.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

import grpc
import grpc.aio

from .channel import refusal, status_of, translated
from .errors import ConnectError, ProtocolError, SightlineError
from .v1 import scene_pb2 as wire

if TYPE_CHECKING:
    from .aio import Client

MAX_WAITING = 32
"""Most messages of a watched view that wait to be read. At most three frames are unacknowledged, so a server that keeps
to the protocol stays far below."""


class Link(Protocol):
    """One open view on its way."""

    async def read(self) -> wire.StreamSceneResponse:
        """The next message; raises when there is none any more."""
        ...

    async def send(self, request: wire.StreamSceneRequest) -> None:
        """Says something to the view."""

    async def close(self) -> None:
        """Ends the view."""


class StreamLink:
    """A stream of the view's own."""

    def __init__(self, client: Client) -> None:
        self._address = client.address
        self._call: grpc.aio.StreamStreamCall[Any, Any] = client._scenes.StreamScene(**client._call() | {"timeout": None})

    @classmethod
    async def open(cls, client: Client, wish: wire.OpenView) -> StreamLink:
        """Opens the view; its opening is the first message."""
        link = cls(client)
        try:
            await link.send(wire.StreamSceneRequest(open=wish))
        except BaseException:
            await link.close()
            raise
        return link

    async def read(self) -> wire.StreamSceneResponse:
        try:
            message = await self._call.read()
        except grpc.RpcError as error:
            raise translated(error, self._address) from None
        if not isinstance(message, wire.StreamSceneResponse):
            raise await self._reason()
        return message

    async def send(self, request: wire.StreamSceneRequest) -> None:
        try:
            await self._call.write(request)
        except asyncio.InvalidStateError:
            raise await self._reason() from None
        except grpc.RpcError as error:
            raise translated(error, self._address) from None

    async def close(self) -> None:
        self._call.cancel()

    async def _reason(self) -> SightlineError:
        """Why the stream is over."""
        code, details = await self._call.code(), await self._call.details()
        if code is grpc.StatusCode.OK:
            return ConnectError(f"{self._address} has closed the view")
        return refusal(code, details or "", self._address)


class WatchLink:
    """A view of a watch. What cannot be read yet waits here, so that no view holds up another."""

    def __init__(self, client: Client, watch_id: str, view_id: int, forget: Callable[[], object]) -> None:
        self._client, self._watch_id, self._view_id = client, watch_id, view_id
        self._forget = forget
        self._waiting: asyncio.Queue[wire.StreamSceneResponse | SightlineError] = asyncio.Queue()
        self._telling = asyncio.Lock()
        self._ended = False

    def take(self, what: wire.StreamSceneResponse | SightlineError) -> None:
        """A message, or why there will be no more."""
        if self._ended:
            return
        if self._waiting.qsize() >= MAX_WAITING:
            what = ProtocolError(f"more than {MAX_WAITING} messages of a view before it acknowledged one")
        if isinstance(what, SightlineError):
            self._ended = True
            self._forget()
        self._waiting.put_nowait(what)

    async def open(self, wish: wire.OpenView) -> None:
        """Opens the view."""
        client = self._client
        request = wire.OpenWatchedViewRequest(watch_id=self._watch_id, view_id=self._view_id, open=wish)
        await client._one(client._scenes.OpenWatchedView(request, **client._call()))

    async def read(self) -> wire.StreamSceneResponse:
        what = await self._waiting.get()
        if isinstance(what, SightlineError):
            self._waiting.put_nowait(what)  # it goes for every read from now on
            raise what
        return what

    async def send(self, request: wire.StreamSceneRequest) -> None:
        client = self._client
        told = wire.TellWatchedViewRequest(watch_id=self._watch_id, view_id=self._view_id)
        if request.HasField("steer"):
            told.steer.CopyFrom(request.steer)
        else:
            told.snapshot.CopyFrom(request.snapshot)
        async with self._telling:  # calls of their own could pass each other
            await client._one(client._scenes.TellWatchedView(told, **client._call()))

    async def close(self) -> None:
        if self._ended:
            return
        self._ended = True
        self._forget()
        client = self._client
        with contextlib.suppress(SightlineError):
            request = wire.CloseWatchedViewRequest(watch_id=self._watch_id, view_id=self._view_id)
            await client._one(client._scenes.CloseWatchedView(request, **client._call()))


class WatchStream:
    """The stream of a watch: it hands each message to the link of its view."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._links: dict[int, WatchLink] = {}
        self._last_id = 0
        self._call: Any = client._scenes.WatchViews(wire.WatchViewsRequest(), **client._call() | {"timeout": None})
        self._reading: asyncio.Task[None] | None = None
        self._watch_id = ""

    @property
    def is_over(self) -> bool:
        """Whether the stream has ended, and its views with it."""
        return self._reading is None or self._reading.done()

    async def begin(self) -> None:
        """Waits for the name of the watch."""
        try:
            first = await asyncio.wait_for(self._call.read(), self._client.timeout_s)
        except grpc.RpcError as error:
            raise translated(error, self._client.address) from None
        except (TimeoutError, asyncio.TimeoutError):
            self._call.cancel()
            raise ConnectError(f"{self._client.address} did not begin the watch in time") from None
        if not isinstance(first, wire.WatchViewsResponse):
            raise await self._reason()
        if not first.HasField("begun"):
            self._call.cancel()
            raise ProtocolError("the first message of a watch is not its name")
        self._watch_id = first.begun.watch_id
        self._reading = asyncio.ensure_future(self._hand_on())

    async def open(self, wish: wire.OpenView) -> WatchLink:
        """Opens a view on it."""
        self._last_id += 1
        view_id = self._last_id
        link = WatchLink(self._client, self._watch_id, view_id, lambda: self._links.pop(view_id, None))
        self._links[view_id] = link  # before the call: the opening may come before its answer
        try:
            await link.open(wish)
        except BaseException:
            await link.close()
            raise
        return link

    async def close(self) -> None:
        """Ends the stream and the views on it."""
        self._call.cancel()
        if self._reading is not None:
            await asyncio.gather(self._reading, return_exceptions=True)

    async def _hand_on(self) -> None:
        why: SightlineError = ConnectError("the watch is closed")
        try:
            while isinstance(said := await self._call.read(), wire.WatchViewsResponse):
                self._take(said)
            why = await self._reason()
        except grpc.RpcError as error:
            why = translated(error, self._client.address)
        finally:
            for link in list(self._links.values()):
                link.take(why)

    def _take(self, said: wire.WatchViewsResponse) -> None:
        if said.HasField("message") and (link := self._links.get(said.message.view_id)):
            link.take(said.message.message)
        elif said.HasField("closed") and (link := self._links.get(said.closed.view_id)):
            code = status_of(said.closed.code)
            over = code is grpc.StatusCode.OK
            address = self._client.address
            link.take(ConnectError(f"{address} has closed the view") if over else refusal(code, said.closed.reason, address))

    async def _reason(self) -> SightlineError:
        code, details = await self._call.code(), await self._call.details()
        if code is grpc.StatusCode.OK:
            return ConnectError(f"{self._client.address} has ended the watch")
        return refusal(code, details or "", self._client.address)
