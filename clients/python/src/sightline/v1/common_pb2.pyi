from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class CoordinateFrame(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    COORDINATE_FRAME_UNSPECIFIED: _ClassVar[CoordinateFrame]
    COORDINATE_FRAME_GRID: _ClassVar[CoordinateFrame]
    COORDINATE_FRAME_MAP: _ClassVar[CoordinateFrame]
    COORDINATE_FRAME_GEOGRAPHIC: _ClassVar[CoordinateFrame]
    COORDINATE_FRAME_SCENE: _ClassVar[CoordinateFrame]

class AltitudeReference(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    ALTITUDE_REFERENCE_UNSPECIFIED: _ClassVar[AltitudeReference]
    ALTITUDE_REFERENCE_ABSOLUTE: _ClassVar[AltitudeReference]
    ALTITUDE_REFERENCE_ABOVE_GROUND: _ClassVar[AltitudeReference]

class Verdict(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    VERDICT_UNSPECIFIED: _ClassVar[Verdict]
    VERDICT_VISIBLE: _ClassVar[Verdict]
    VERDICT_UNKNOWN: _ClassVar[Verdict]
    VERDICT_BLOCKED: _ClassVar[Verdict]

class UnknownReason(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    UNKNOWN_REASON_UNSPECIFIED: _ClassVar[UnknownReason]
    UNKNOWN_REASON_UNKNOWN_GROUND: _ClassVar[UnknownReason]
    UNKNOWN_REASON_NO_GROUND: _ClassVar[UnknownReason]
    UNKNOWN_REASON_INACTIVE: _ClassVar[UnknownReason]
COORDINATE_FRAME_UNSPECIFIED: CoordinateFrame
COORDINATE_FRAME_GRID: CoordinateFrame
COORDINATE_FRAME_MAP: CoordinateFrame
COORDINATE_FRAME_GEOGRAPHIC: CoordinateFrame
COORDINATE_FRAME_SCENE: CoordinateFrame
ALTITUDE_REFERENCE_UNSPECIFIED: AltitudeReference
ALTITUDE_REFERENCE_ABSOLUTE: AltitudeReference
ALTITUDE_REFERENCE_ABOVE_GROUND: AltitudeReference
VERDICT_UNSPECIFIED: Verdict
VERDICT_VISIBLE: Verdict
VERDICT_UNKNOWN: Verdict
VERDICT_BLOCKED: Verdict
UNKNOWN_REASON_UNSPECIFIED: UnknownReason
UNKNOWN_REASON_UNKNOWN_GROUND: UnknownReason
UNKNOWN_REASON_NO_GROUND: UnknownReason
UNKNOWN_REASON_INACTIVE: UnknownReason

class Position(_message.Message):
    __slots__ = ("x", "y", "z")
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    Z_FIELD_NUMBER: _ClassVar[int]
    x: float
    y: float
    z: float
    def __init__(self, x: _Optional[float] = ..., y: _Optional[float] = ..., z: _Optional[float] = ...) -> None: ...

class Segment(_message.Message):
    __slots__ = ("a", "b")
    A_FIELD_NUMBER: _ClassVar[int]
    B_FIELD_NUMBER: _ClassVar[int]
    a: Position
    b: Position
    def __init__(self, a: _Optional[_Union[Position, _Mapping]] = ..., b: _Optional[_Union[Position, _Mapping]] = ...) -> None: ...
