"""How a client reaches a server: certificates, a token, the channel, and what its errors mean."""

from __future__ import annotations

from dataclasses import dataclass, field

import grpc
import grpc.aio

from .errors import ConnectError, DeadlineExceeded, Refused, SightlineError

MAX_MESSAGE_BYTES = 64 << 20
"""Greatest size of a message that a client accepts: a snapshot of millions of triangles fits."""

_OPTIONS = [
    ("grpc.max_receive_message_length", MAX_MESSAGE_BYTES),
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.max_reconnect_backoff_ms", 1000),
]


@dataclass(frozen=True)
class Access:
    """What a client trusts, and who it is."""

    authorities: bytes | None = None
    """The authorities one of which must have signed the server's certificate, PEM; None: those that the system trusts."""
    identity: tuple[bytes, bytes] | None = field(default=None, repr=False)
    """This client's certificate and its key, PEM, for servers that ask for one."""
    token: str | None = field(default=None, repr=False)
    """The secret of this client's token."""


def make(address: str, access: Access) -> grpc.aio.Channel:
    """A channel to `address`, with TLS for ``https://``."""
    if not address.startswith("https://"):
        return grpc.aio.insecure_channel(address.removeprefix("http://"), options=_OPTIONS)
    certificate, key = access.identity or (None, None)
    credentials = grpc.ssl_channel_credentials(access.authorities, key, certificate)
    return grpc.aio.secure_channel(address.removeprefix("https://"), credentials, options=_OPTIONS)


async def ready(channel: grpc.aio.Channel, failed: ConnectError) -> None:
    """Waits until the channel is connected; raises `failed` when it cannot be."""
    while (state := channel.get_state(try_to_connect=True)) is not grpc.ChannelConnectivity.READY:
        if state is grpc.ChannelConnectivity.TRANSIENT_FAILURE:
            raise failed
        await channel.wait_for_state_change(state)


def translated(error: grpc.RpcError, address: str) -> SightlineError:
    """The error of this package for one of grpc's."""
    return refusal(error.code(), error.details() or "", address)


def refusal(code: grpc.StatusCode, details: str, address: str) -> SightlineError:
    """The error of this package for a status of `address`."""
    if code is grpc.StatusCode.UNAVAILABLE:
        return ConnectError(f"no connection to {address}: {details}")
    if code is grpc.StatusCode.DEADLINE_EXCEEDED:
        return DeadlineExceeded(code.name, details)
    return Refused(code.name, details)


def status_of(number: int) -> grpc.StatusCode:
    """The status with this number; UNKNOWN for one that there is not."""
    return next((code for code in grpc.StatusCode if code.value[0] == number), grpc.StatusCode.UNKNOWN)
