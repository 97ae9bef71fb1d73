"""What can go wrong. A verdict is never an error, and an error is never a verdict."""

from __future__ import annotations


class SightlineError(Exception):
    """Base of all errors of this package."""


class ConnectError(SightlineError):
    """No server answers at an address, or the connection to it was lost."""


class Refused(SightlineError):
    """The server refused a call.

    `code` is the gRPC status code by name, such as ``INVALID_ARGUMENT`` (the message names the field) or
    ``RESOURCE_EXHAUSTED`` (it names the limit).
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(f"{code}: {message}")
        self.code = code
        self.message = message


class DeadlineExceeded(Refused, TimeoutError):
    """The time allowed for a call is over."""


class ProtocolError(SightlineError):
    """The server said something that the protocol does not allow."""


class PayloadError(ProtocolError):
    """Bytes that are no mesh payload, or one that does not give the mesh that its frame announces.

    The replica is as it was before.
    """


class SceneError(ProtocolError):
    """A message of a scene stream that does not fit those before it. The scene is as it was before."""
