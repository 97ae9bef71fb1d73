from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class GetStatusRequest(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class GetStatusResponse(_message.Message):
    __slots__ = ("version", "uptime_s", "serving", "troubles", "limits", "connections", "exercises", "calls", "refused_calls", "frames", "frame_median_ms", "frame_p99_ms", "queue_age_ms", "visible", "blocked", "unknown", "exact_signs", "unsatisfied_lines", "received_bytes", "sent_bytes", "recording")
    VERSION_FIELD_NUMBER: _ClassVar[int]
    UPTIME_S_FIELD_NUMBER: _ClassVar[int]
    SERVING_FIELD_NUMBER: _ClassVar[int]
    TROUBLES_FIELD_NUMBER: _ClassVar[int]
    LIMITS_FIELD_NUMBER: _ClassVar[int]
    CONNECTIONS_FIELD_NUMBER: _ClassVar[int]
    EXERCISES_FIELD_NUMBER: _ClassVar[int]
    CALLS_FIELD_NUMBER: _ClassVar[int]
    REFUSED_CALLS_FIELD_NUMBER: _ClassVar[int]
    FRAMES_FIELD_NUMBER: _ClassVar[int]
    FRAME_MEDIAN_MS_FIELD_NUMBER: _ClassVar[int]
    FRAME_P99_MS_FIELD_NUMBER: _ClassVar[int]
    QUEUE_AGE_MS_FIELD_NUMBER: _ClassVar[int]
    VISIBLE_FIELD_NUMBER: _ClassVar[int]
    BLOCKED_FIELD_NUMBER: _ClassVar[int]
    UNKNOWN_FIELD_NUMBER: _ClassVar[int]
    EXACT_SIGNS_FIELD_NUMBER: _ClassVar[int]
    UNSATISFIED_LINES_FIELD_NUMBER: _ClassVar[int]
    RECEIVED_BYTES_FIELD_NUMBER: _ClassVar[int]
    SENT_BYTES_FIELD_NUMBER: _ClassVar[int]
    RECORDING_FIELD_NUMBER: _ClassVar[int]
    version: str
    uptime_s: float
    serving: bool
    troubles: _containers.RepeatedScalarFieldContainer[str]
    limits: _containers.RepeatedCompositeFieldContainer[LimitUse]
    connections: int
    exercises: int
    calls: int
    refused_calls: int
    frames: int
    frame_median_ms: float
    frame_p99_ms: float
    queue_age_ms: float
    visible: int
    blocked: int
    unknown: int
    exact_signs: int
    unsatisfied_lines: int
    received_bytes: int
    sent_bytes: int
    recording: RecordingState
    def __init__(self, version: _Optional[str] = ..., uptime_s: _Optional[float] = ..., serving: bool = ..., troubles: _Optional[_Iterable[str]] = ..., limits: _Optional[_Iterable[_Union[LimitUse, _Mapping]]] = ..., connections: _Optional[int] = ..., exercises: _Optional[int] = ..., calls: _Optional[int] = ..., refused_calls: _Optional[int] = ..., frames: _Optional[int] = ..., frame_median_ms: _Optional[float] = ..., frame_p99_ms: _Optional[float] = ..., queue_age_ms: _Optional[float] = ..., visible: _Optional[int] = ..., blocked: _Optional[int] = ..., unknown: _Optional[int] = ..., exact_signs: _Optional[int] = ..., unsatisfied_lines: _Optional[int] = ..., received_bytes: _Optional[int] = ..., sent_bytes: _Optional[int] = ..., recording: _Optional[_Union[RecordingState, _Mapping]] = ...) -> None: ...

class RecordingState(_message.Message):
    __slots__ = ("bytes", "limit_bytes", "ended")
    BYTES_FIELD_NUMBER: _ClassVar[int]
    LIMIT_BYTES_FIELD_NUMBER: _ClassVar[int]
    ENDED_FIELD_NUMBER: _ClassVar[int]
    bytes: int
    limit_bytes: int
    ended: str
    def __init__(self, bytes: _Optional[int] = ..., limit_bytes: _Optional[int] = ..., ended: _Optional[str] = ...) -> None: ...

class LimitUse(_message.Message):
    __slots__ = ("name", "used", "limit")
    NAME_FIELD_NUMBER: _ClassVar[int]
    USED_FIELD_NUMBER: _ClassVar[int]
    LIMIT_FIELD_NUMBER: _ClassVar[int]
    name: str
    used: int
    limit: int
    def __init__(self, name: _Optional[str] = ..., used: _Optional[int] = ..., limit: _Optional[int] = ...) -> None: ...
