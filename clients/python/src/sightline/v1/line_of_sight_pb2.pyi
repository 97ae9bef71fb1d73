from sightline.v1 import common_pb2 as _common_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Precision(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    PRECISION_UNSPECIFIED: _ClassVar[Precision]
    PRECISION_EXACT: _ClassVar[Precision]
    PRECISION_F64: _ClassVar[Precision]
    PRECISION_FAST: _ClassVar[Precision]
    PRECISION_TOLERANCE: _ClassVar[Precision]

class LineState(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    LINE_STATE_UNSPECIFIED: _ClassVar[LineState]
    LINE_STATE_ABOVE: _ClassVar[LineState]
    LINE_STATE_BELOW: _ClassVar[LineState]
    LINE_STATE_UNKNOWN: _ClassVar[LineState]

class GroundState(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    GROUND_STATE_UNSPECIFIED: _ClassVar[GroundState]
    GROUND_STATE_SEEN: _ClassVar[GroundState]
    GROUND_STATE_HIDDEN: _ClassVar[GroundState]
    GROUND_STATE_UNKNOWN: _ClassVar[GroundState]

class RayEnd(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    RAY_END_UNSPECIFIED: _ClassVar[RayEnd]
    RAY_END_HIT: _ClassVar[RayEnd]
    RAY_END_MISS: _ClassVar[RayEnd]
    RAY_END_STARTS_BELOW: _ClassVar[RayEnd]
    RAY_END_NO_GROUND: _ClassVar[RayEnd]
PRECISION_UNSPECIFIED: Precision
PRECISION_EXACT: Precision
PRECISION_F64: Precision
PRECISION_FAST: Precision
PRECISION_TOLERANCE: Precision
LINE_STATE_UNSPECIFIED: LineState
LINE_STATE_ABOVE: LineState
LINE_STATE_BELOW: LineState
LINE_STATE_UNKNOWN: LineState
GROUND_STATE_UNSPECIFIED: GroundState
GROUND_STATE_SEEN: GroundState
GROUND_STATE_HIDDEN: GroundState
GROUND_STATE_UNKNOWN: GroundState
RAY_END_UNSPECIFIED: RayEnd
RAY_END_HIT: RayEnd
RAY_END_MISS: RayEnd
RAY_END_STARTS_BELOW: RayEnd
RAY_END_NO_GROUND: RayEnd

class SphericalEarth(_message.Message):
    __slots__ = ("radius_m", "refraction")
    RADIUS_M_FIELD_NUMBER: _ClassVar[int]
    REFRACTION_FIELD_NUMBER: _ClassVar[int]
    radius_m: float
    refraction: float
    def __init__(self, radius_m: _Optional[float] = ..., refraction: _Optional[float] = ...) -> None: ...

class QueryOptions(_message.Message):
    __slots__ = ("precision", "tolerance", "sphere")
    PRECISION_FIELD_NUMBER: _ClassVar[int]
    TOLERANCE_FIELD_NUMBER: _ClassVar[int]
    SPHERE_FIELD_NUMBER: _ClassVar[int]
    precision: Precision
    tolerance: float
    sphere: SphericalEarth
    def __init__(self, precision: _Optional[_Union[Precision, str]] = ..., tolerance: _Optional[float] = ..., sphere: _Optional[_Union[SphericalEarth, _Mapping]] = ...) -> None: ...

class SightLineEnd(_message.Message):
    __slots__ = ("position", "frame", "altitude")
    POSITION_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ALTITUDE_FIELD_NUMBER: _ClassVar[int]
    position: _common_pb2.Position
    frame: _common_pb2.CoordinateFrame
    altitude: _common_pb2.AltitudeReference
    def __init__(self, position: _Optional[_Union[_common_pb2.Position, _Mapping]] = ..., frame: _Optional[_Union[_common_pb2.CoordinateFrame, str]] = ..., altitude: _Optional[_Union[_common_pb2.AltitudeReference, str]] = ...) -> None: ...

class QueryLineOfSightRequest(_message.Message):
    __slots__ = ("a", "b", "strict", "derive", "options", "stretches")
    A_FIELD_NUMBER: _ClassVar[int]
    B_FIELD_NUMBER: _ClassVar[int]
    STRICT_FIELD_NUMBER: _ClassVar[int]
    DERIVE_FIELD_NUMBER: _ClassVar[int]
    OPTIONS_FIELD_NUMBER: _ClassVar[int]
    STRETCHES_FIELD_NUMBER: _ClassVar[int]
    a: SightLineEnd
    b: SightLineEnd
    strict: bool
    derive: bool
    options: QueryOptions
    stretches: bool
    def __init__(self, a: _Optional[_Union[SightLineEnd, _Mapping]] = ..., b: _Optional[_Union[SightLineEnd, _Mapping]] = ..., strict: bool = ..., derive: bool = ..., options: _Optional[_Union[QueryOptions, _Mapping]] = ..., stretches: bool = ...) -> None: ...

class LineStretch(_message.Message):
    __slots__ = ("to", "state")
    FROM_FIELD_NUMBER: _ClassVar[int]
    TO_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    to: float
    state: LineState
    def __init__(self, to: _Optional[float] = ..., state: _Optional[_Union[LineState, str]] = ..., **kwargs) -> None: ...

class GroundStretch(_message.Message):
    __slots__ = ("to", "state")
    FROM_FIELD_NUMBER: _ClassVar[int]
    TO_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    to: float
    state: GroundState
    def __init__(self, to: _Optional[float] = ..., state: _Optional[_Union[GroundState, str]] = ..., **kwargs) -> None: ...

class QueryLineOfSightResponse(_message.Message):
    __slots__ = ("verdict", "unknown_reason", "resolved", "grazes", "range_m", "sagitta_m", "first_from_a", "first_from_b", "least_clearance", "certain", "least_clearance_at", "deepest", "deepest_at", "least_target_z", "line", "ground")
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    UNKNOWN_REASON_FIELD_NUMBER: _ClassVar[int]
    RESOLVED_FIELD_NUMBER: _ClassVar[int]
    GRAZES_FIELD_NUMBER: _ClassVar[int]
    RANGE_M_FIELD_NUMBER: _ClassVar[int]
    SAGITTA_M_FIELD_NUMBER: _ClassVar[int]
    FIRST_FROM_A_FIELD_NUMBER: _ClassVar[int]
    FIRST_FROM_B_FIELD_NUMBER: _ClassVar[int]
    LEAST_CLEARANCE_FIELD_NUMBER: _ClassVar[int]
    CERTAIN_FIELD_NUMBER: _ClassVar[int]
    LEAST_CLEARANCE_AT_FIELD_NUMBER: _ClassVar[int]
    DEEPEST_FIELD_NUMBER: _ClassVar[int]
    DEEPEST_AT_FIELD_NUMBER: _ClassVar[int]
    LEAST_TARGET_Z_FIELD_NUMBER: _ClassVar[int]
    LINE_FIELD_NUMBER: _ClassVar[int]
    GROUND_FIELD_NUMBER: _ClassVar[int]
    verdict: _common_pb2.Verdict
    unknown_reason: _common_pb2.UnknownReason
    resolved: _common_pb2.Segment
    grazes: bool
    range_m: float
    sagitta_m: float
    first_from_a: Obstruction
    first_from_b: Obstruction
    least_clearance: float
    certain: bool
    least_clearance_at: _common_pb2.Position
    deepest: float
    deepest_at: _common_pb2.Position
    least_target_z: float
    line: _containers.RepeatedCompositeFieldContainer[LineStretch]
    ground: _containers.RepeatedCompositeFieldContainer[GroundStretch]
    def __init__(self, verdict: _Optional[_Union[_common_pb2.Verdict, str]] = ..., unknown_reason: _Optional[_Union[_common_pb2.UnknownReason, str]] = ..., resolved: _Optional[_Union[_common_pb2.Segment, _Mapping]] = ..., grazes: bool = ..., range_m: _Optional[float] = ..., sagitta_m: _Optional[float] = ..., first_from_a: _Optional[_Union[Obstruction, _Mapping]] = ..., first_from_b: _Optional[_Union[Obstruction, _Mapping]] = ..., least_clearance: _Optional[float] = ..., certain: bool = ..., least_clearance_at: _Optional[_Union[_common_pb2.Position, _Mapping]] = ..., deepest: _Optional[float] = ..., deepest_at: _Optional[_Union[_common_pb2.Position, _Mapping]] = ..., least_target_z: _Optional[float] = ..., line: _Optional[_Iterable[_Union[LineStretch, _Mapping]]] = ..., ground: _Optional[_Iterable[_Union[GroundStretch, _Mapping]]] = ...) -> None: ...

class Obstruction(_message.Message):
    __slots__ = ("position", "range_m", "triangle")
    POSITION_FIELD_NUMBER: _ClassVar[int]
    RANGE_M_FIELD_NUMBER: _ClassVar[int]
    TRIANGLE_FIELD_NUMBER: _ClassVar[int]
    position: _common_pb2.Position
    range_m: float
    triangle: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, position: _Optional[_Union[_common_pb2.Position, _Mapping]] = ..., range_m: _Optional[float] = ..., triangle: _Optional[_Iterable[int]] = ...) -> None: ...

class QueryLineOfSightBatchRequest(_message.Message):
    __slots__ = ("frame", "altitude", "strict", "ax", "ay", "az", "bx", "by", "bz", "options")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ALTITUDE_FIELD_NUMBER: _ClassVar[int]
    STRICT_FIELD_NUMBER: _ClassVar[int]
    AX_FIELD_NUMBER: _ClassVar[int]
    AY_FIELD_NUMBER: _ClassVar[int]
    AZ_FIELD_NUMBER: _ClassVar[int]
    BX_FIELD_NUMBER: _ClassVar[int]
    BY_FIELD_NUMBER: _ClassVar[int]
    BZ_FIELD_NUMBER: _ClassVar[int]
    OPTIONS_FIELD_NUMBER: _ClassVar[int]
    frame: _common_pb2.CoordinateFrame
    altitude: _common_pb2.AltitudeReference
    strict: bool
    ax: _containers.RepeatedScalarFieldContainer[float]
    ay: _containers.RepeatedScalarFieldContainer[float]
    az: _containers.RepeatedScalarFieldContainer[float]
    bx: _containers.RepeatedScalarFieldContainer[float]
    by: _containers.RepeatedScalarFieldContainer[float]
    bz: _containers.RepeatedScalarFieldContainer[float]
    options: QueryOptions
    def __init__(self, frame: _Optional[_Union[_common_pb2.CoordinateFrame, str]] = ..., altitude: _Optional[_Union[_common_pb2.AltitudeReference, str]] = ..., strict: bool = ..., ax: _Optional[_Iterable[float]] = ..., ay: _Optional[_Iterable[float]] = ..., az: _Optional[_Iterable[float]] = ..., bx: _Optional[_Iterable[float]] = ..., by: _Optional[_Iterable[float]] = ..., bz: _Optional[_Iterable[float]] = ..., options: _Optional[_Union[QueryOptions, _Mapping]] = ...) -> None: ...

class QueryLineOfSightBatchResponse(_message.Message):
    __slots__ = ("first_index", "verdicts", "grazes", "certain")
    FIRST_INDEX_FIELD_NUMBER: _ClassVar[int]
    VERDICTS_FIELD_NUMBER: _ClassVar[int]
    GRAZES_FIELD_NUMBER: _ClassVar[int]
    CERTAIN_FIELD_NUMBER: _ClassVar[int]
    first_index: int
    verdicts: _containers.RepeatedScalarFieldContainer[_common_pb2.Verdict]
    grazes: _containers.RepeatedScalarFieldContainer[bool]
    certain: _containers.RepeatedScalarFieldContainer[bool]
    def __init__(self, first_index: _Optional[int] = ..., verdicts: _Optional[_Iterable[_Union[_common_pb2.Verdict, str]]] = ..., grazes: _Optional[_Iterable[bool]] = ..., certain: _Optional[_Iterable[bool]] = ...) -> None: ...

class StreamLinesOfSightRequest(_message.Message):
    __slots__ = ("ids", "lines")
    IDS_FIELD_NUMBER: _ClassVar[int]
    LINES_FIELD_NUMBER: _ClassVar[int]
    ids: _containers.RepeatedScalarFieldContainer[int]
    lines: QueryLineOfSightBatchRequest
    def __init__(self, ids: _Optional[_Iterable[int]] = ..., lines: _Optional[_Union[QueryLineOfSightBatchRequest, _Mapping]] = ...) -> None: ...

class StreamLinesOfSightResponse(_message.Message):
    __slots__ = ("ids", "verdicts", "grazes", "certain", "refusal")
    IDS_FIELD_NUMBER: _ClassVar[int]
    VERDICTS_FIELD_NUMBER: _ClassVar[int]
    GRAZES_FIELD_NUMBER: _ClassVar[int]
    CERTAIN_FIELD_NUMBER: _ClassVar[int]
    REFUSAL_FIELD_NUMBER: _ClassVar[int]
    ids: _containers.RepeatedScalarFieldContainer[int]
    verdicts: _containers.RepeatedScalarFieldContainer[_common_pb2.Verdict]
    grazes: _containers.RepeatedScalarFieldContainer[bool]
    certain: _containers.RepeatedScalarFieldContainer[bool]
    refusal: Refusal
    def __init__(self, ids: _Optional[_Iterable[int]] = ..., verdicts: _Optional[_Iterable[_Union[_common_pb2.Verdict, str]]] = ..., grazes: _Optional[_Iterable[bool]] = ..., certain: _Optional[_Iterable[bool]] = ..., refusal: _Optional[_Union[Refusal, _Mapping]] = ...) -> None: ...

class Refusal(_message.Message):
    __slots__ = ("code", "message")
    CODE_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    code: int
    message: str
    def __init__(self, code: _Optional[int] = ..., message: _Optional[str] = ...) -> None: ...

class QueryRayRequest(_message.Message):
    __slots__ = ("azimuth_deg", "elevation_deg", "range_m", "options")
    FROM_FIELD_NUMBER: _ClassVar[int]
    AZIMUTH_DEG_FIELD_NUMBER: _ClassVar[int]
    ELEVATION_DEG_FIELD_NUMBER: _ClassVar[int]
    RANGE_M_FIELD_NUMBER: _ClassVar[int]
    OPTIONS_FIELD_NUMBER: _ClassVar[int]
    azimuth_deg: float
    elevation_deg: float
    range_m: float
    options: QueryOptions
    def __init__(self, azimuth_deg: _Optional[float] = ..., elevation_deg: _Optional[float] = ..., range_m: _Optional[float] = ..., options: _Optional[_Union[QueryOptions, _Mapping]] = ..., **kwargs) -> None: ...

class QueryRayResponse(_message.Message):
    __slots__ = ("end", "resolved", "hit", "range_m", "normal", "over_unknown")
    END_FIELD_NUMBER: _ClassVar[int]
    RESOLVED_FIELD_NUMBER: _ClassVar[int]
    HIT_FIELD_NUMBER: _ClassVar[int]
    RANGE_M_FIELD_NUMBER: _ClassVar[int]
    NORMAL_FIELD_NUMBER: _ClassVar[int]
    OVER_UNKNOWN_FIELD_NUMBER: _ClassVar[int]
    end: RayEnd
    resolved: _common_pb2.Segment
    hit: _common_pb2.Position
    range_m: float
    normal: _common_pb2.Position
    over_unknown: bool
    def __init__(self, end: _Optional[_Union[RayEnd, str]] = ..., resolved: _Optional[_Union[_common_pb2.Segment, _Mapping]] = ..., hit: _Optional[_Union[_common_pb2.Position, _Mapping]] = ..., range_m: _Optional[float] = ..., normal: _Optional[_Union[_common_pb2.Position, _Mapping]] = ..., over_unknown: bool = ...) -> None: ...

class QueryHorizonRequest(_message.Message):
    __slots__ = ("azimuths_deg", "range_m", "options")
    FROM_FIELD_NUMBER: _ClassVar[int]
    AZIMUTHS_DEG_FIELD_NUMBER: _ClassVar[int]
    RANGE_M_FIELD_NUMBER: _ClassVar[int]
    OPTIONS_FIELD_NUMBER: _ClassVar[int]
    azimuths_deg: _containers.RepeatedScalarFieldContainer[float]
    range_m: float
    options: QueryOptions
    def __init__(self, azimuths_deg: _Optional[_Iterable[float]] = ..., range_m: _Optional[float] = ..., options: _Optional[_Union[QueryOptions, _Mapping]] = ..., **kwargs) -> None: ...

class QueryHorizonResponse(_message.Message):
    __slots__ = ("resolved", "known", "elevation_deg", "range_m", "over_unknown", "below_ground")
    RESOLVED_FIELD_NUMBER: _ClassVar[int]
    KNOWN_FIELD_NUMBER: _ClassVar[int]
    ELEVATION_DEG_FIELD_NUMBER: _ClassVar[int]
    RANGE_M_FIELD_NUMBER: _ClassVar[int]
    OVER_UNKNOWN_FIELD_NUMBER: _ClassVar[int]
    BELOW_GROUND_FIELD_NUMBER: _ClassVar[int]
    resolved: _common_pb2.Position
    known: _containers.RepeatedScalarFieldContainer[bool]
    elevation_deg: _containers.RepeatedScalarFieldContainer[float]
    range_m: _containers.RepeatedScalarFieldContainer[float]
    over_unknown: _containers.RepeatedScalarFieldContainer[bool]
    below_ground: bool
    def __init__(self, resolved: _Optional[_Union[_common_pb2.Position, _Mapping]] = ..., known: _Optional[_Iterable[bool]] = ..., elevation_deg: _Optional[_Iterable[float]] = ..., range_m: _Optional[_Iterable[float]] = ..., over_unknown: _Optional[_Iterable[bool]] = ..., below_ground: bool = ...) -> None: ...

class QueryProfileRequest(_message.Message):
    __slots__ = ("frame", "ax", "ay", "bx", "by", "options")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    AX_FIELD_NUMBER: _ClassVar[int]
    AY_FIELD_NUMBER: _ClassVar[int]
    BX_FIELD_NUMBER: _ClassVar[int]
    BY_FIELD_NUMBER: _ClassVar[int]
    OPTIONS_FIELD_NUMBER: _ClassVar[int]
    frame: _common_pb2.CoordinateFrame
    ax: float
    ay: float
    bx: float
    by: float
    options: QueryOptions
    def __init__(self, frame: _Optional[_Union[_common_pb2.CoordinateFrame, str]] = ..., ax: _Optional[float] = ..., ay: _Optional[float] = ..., bx: _Optional[float] = ..., by: _Optional[float] = ..., options: _Optional[_Union[QueryOptions, _Mapping]] = ...) -> None: ...

class QueryProfileResponse(_message.Message):
    __slots__ = ("t", "x", "y", "ground", "known", "known_after", "bulge")
    T_FIELD_NUMBER: _ClassVar[int]
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    GROUND_FIELD_NUMBER: _ClassVar[int]
    KNOWN_FIELD_NUMBER: _ClassVar[int]
    KNOWN_AFTER_FIELD_NUMBER: _ClassVar[int]
    BULGE_FIELD_NUMBER: _ClassVar[int]
    t: _containers.RepeatedScalarFieldContainer[float]
    x: _containers.RepeatedScalarFieldContainer[float]
    y: _containers.RepeatedScalarFieldContainer[float]
    ground: _containers.RepeatedScalarFieldContainer[float]
    known: _containers.RepeatedScalarFieldContainer[bool]
    known_after: _containers.RepeatedScalarFieldContainer[bool]
    bulge: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, t: _Optional[_Iterable[float]] = ..., x: _Optional[_Iterable[float]] = ..., y: _Optional[_Iterable[float]] = ..., ground: _Optional[_Iterable[float]] = ..., known: _Optional[_Iterable[bool]] = ..., known_after: _Optional[_Iterable[bool]] = ..., bulge: _Optional[_Iterable[float]] = ...) -> None: ...

class QueryViewshedRequest(_message.Message):
    __slots__ = ("observer", "target_height_m", "radius_m", "rectangle", "strict", "options")
    OBSERVER_FIELD_NUMBER: _ClassVar[int]
    TARGET_HEIGHT_M_FIELD_NUMBER: _ClassVar[int]
    RADIUS_M_FIELD_NUMBER: _ClassVar[int]
    RECTANGLE_FIELD_NUMBER: _ClassVar[int]
    STRICT_FIELD_NUMBER: _ClassVar[int]
    OPTIONS_FIELD_NUMBER: _ClassVar[int]
    observer: SightLineEnd
    target_height_m: float
    radius_m: float
    rectangle: PostRectangle
    strict: bool
    options: QueryOptions
    def __init__(self, observer: _Optional[_Union[SightLineEnd, _Mapping]] = ..., target_height_m: _Optional[float] = ..., radius_m: _Optional[float] = ..., rectangle: _Optional[_Union[PostRectangle, _Mapping]] = ..., strict: bool = ..., options: _Optional[_Union[QueryOptions, _Mapping]] = ...) -> None: ...

class PostRectangle(_message.Message):
    __slots__ = ("first_i", "last_i", "first_j", "last_j")
    FIRST_I_FIELD_NUMBER: _ClassVar[int]
    LAST_I_FIELD_NUMBER: _ClassVar[int]
    FIRST_J_FIELD_NUMBER: _ClassVar[int]
    LAST_J_FIELD_NUMBER: _ClassVar[int]
    first_i: int
    last_i: int
    first_j: int
    last_j: int
    def __init__(self, first_i: _Optional[int] = ..., last_i: _Optional[int] = ..., first_j: _Optional[int] = ..., last_j: _Optional[int] = ...) -> None: ...

class QueryViewshedResponse(_message.Message):
    __slots__ = ("first_i", "first_j", "cells", "done", "total")
    FIRST_I_FIELD_NUMBER: _ClassVar[int]
    FIRST_J_FIELD_NUMBER: _ClassVar[int]
    CELLS_FIELD_NUMBER: _ClassVar[int]
    DONE_FIELD_NUMBER: _ClassVar[int]
    TOTAL_FIELD_NUMBER: _ClassVar[int]
    first_i: int
    first_j: int
    cells: bytes
    done: int
    total: int
    def __init__(self, first_i: _Optional[int] = ..., first_j: _Optional[int] = ..., cells: _Optional[bytes] = ..., done: _Optional[int] = ..., total: _Optional[int] = ...) -> None: ...

class QueryIntervisibilityRequest(_message.Message):
    __slots__ = ("frame", "altitude", "x", "y", "z", "strict", "options")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ALTITUDE_FIELD_NUMBER: _ClassVar[int]
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    Z_FIELD_NUMBER: _ClassVar[int]
    STRICT_FIELD_NUMBER: _ClassVar[int]
    OPTIONS_FIELD_NUMBER: _ClassVar[int]
    frame: _common_pb2.CoordinateFrame
    altitude: _common_pb2.AltitudeReference
    x: _containers.RepeatedScalarFieldContainer[float]
    y: _containers.RepeatedScalarFieldContainer[float]
    z: _containers.RepeatedScalarFieldContainer[float]
    strict: bool
    options: QueryOptions
    def __init__(self, frame: _Optional[_Union[_common_pb2.CoordinateFrame, str]] = ..., altitude: _Optional[_Union[_common_pb2.AltitudeReference, str]] = ..., x: _Optional[_Iterable[float]] = ..., y: _Optional[_Iterable[float]] = ..., z: _Optional[_Iterable[float]] = ..., strict: bool = ..., options: _Optional[_Union[QueryOptions, _Mapping]] = ...) -> None: ...

class QueryIntervisibilityResponse(_message.Message):
    __slots__ = ("row", "verdicts")
    ROW_FIELD_NUMBER: _ClassVar[int]
    VERDICTS_FIELD_NUMBER: _ClassVar[int]
    row: int
    verdicts: _containers.RepeatedScalarFieldContainer[_common_pb2.Verdict]
    def __init__(self, row: _Optional[int] = ..., verdicts: _Optional[_Iterable[_Union[_common_pb2.Verdict, str]]] = ...) -> None: ...
