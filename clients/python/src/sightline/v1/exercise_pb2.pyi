from sightline.v1 import common_pb2 as _common_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Fidelity(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    FIDELITY_UNSPECIFIED: _ClassVar[Fidelity]
    FIDELITY_VERDICT: _ClassVar[Fidelity]
    FIDELITY_WEDGIE: _ClassVar[Fidelity]
    FIDELITY_PROFILE: _ClassVar[Fidelity]
    FIDELITY_OBSTRUCTION: _ClassVar[Fidelity]
FIDELITY_UNSPECIFIED: Fidelity
FIDELITY_VERDICT: Fidelity
FIDELITY_WEDGIE: Fidelity
FIDELITY_PROFILE: Fidelity
FIDELITY_OBSTRUCTION: Fidelity

class Lease(_message.Message):
    __slots__ = ("owner", "term_s")
    OWNER_FIELD_NUMBER: _ClassVar[int]
    TERM_S_FIELD_NUMBER: _ClassVar[int]
    owner: str
    term_s: int
    def __init__(self, owner: _Optional[str] = ..., term_s: _Optional[int] = ...) -> None: ...

class LeaseState(_message.Message):
    __slots__ = ("owner", "term_s", "remaining_s", "streams", "holds_exercise", "entities", "sight_lines")
    OWNER_FIELD_NUMBER: _ClassVar[int]
    TERM_S_FIELD_NUMBER: _ClassVar[int]
    REMAINING_S_FIELD_NUMBER: _ClassVar[int]
    STREAMS_FIELD_NUMBER: _ClassVar[int]
    HOLDS_EXERCISE_FIELD_NUMBER: _ClassVar[int]
    ENTITIES_FIELD_NUMBER: _ClassVar[int]
    SIGHT_LINES_FIELD_NUMBER: _ClassVar[int]
    owner: str
    term_s: int
    remaining_s: float
    streams: int
    holds_exercise: bool
    entities: int
    sight_lines: int
    def __init__(self, owner: _Optional[str] = ..., term_s: _Optional[int] = ..., remaining_s: _Optional[float] = ..., streams: _Optional[int] = ..., holds_exercise: bool = ..., entities: _Optional[int] = ..., sight_lines: _Optional[int] = ...) -> None: ...

class Entity(_message.Message):
    __slots__ = ("id", "position", "frame", "altitude", "ground_m")
    ID_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ALTITUDE_FIELD_NUMBER: _ClassVar[int]
    GROUND_M_FIELD_NUMBER: _ClassVar[int]
    id: int
    position: _common_pb2.Position
    frame: _common_pb2.CoordinateFrame
    altitude: _common_pb2.AltitudeReference
    ground_m: float
    def __init__(self, id: _Optional[int] = ..., position: _Optional[_Union[_common_pb2.Position, _Mapping]] = ..., frame: _Optional[_Union[_common_pb2.CoordinateFrame, str]] = ..., altitude: _Optional[_Union[_common_pb2.AltitudeReference, str]] = ..., ground_m: _Optional[float] = ...) -> None: ...

class Anchor(_message.Message):
    __slots__ = ("entity", "point")
    ENTITY_FIELD_NUMBER: _ClassVar[int]
    POINT_FIELD_NUMBER: _ClassVar[int]
    entity: EntityAnchor
    point: PointAnchor
    def __init__(self, entity: _Optional[_Union[EntityAnchor, _Mapping]] = ..., point: _Optional[_Union[PointAnchor, _Mapping]] = ...) -> None: ...

class EntityAnchor(_message.Message):
    __slots__ = ("entity_id", "height_offset_m")
    ENTITY_ID_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_OFFSET_M_FIELD_NUMBER: _ClassVar[int]
    entity_id: int
    height_offset_m: float
    def __init__(self, entity_id: _Optional[int] = ..., height_offset_m: _Optional[float] = ...) -> None: ...

class PointAnchor(_message.Message):
    __slots__ = ("position", "frame", "altitude")
    POSITION_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ALTITUDE_FIELD_NUMBER: _ClassVar[int]
    position: _common_pb2.Position
    frame: _common_pb2.CoordinateFrame
    altitude: _common_pb2.AltitudeReference
    def __init__(self, position: _Optional[_Union[_common_pb2.Position, _Mapping]] = ..., frame: _Optional[_Union[_common_pb2.CoordinateFrame, str]] = ..., altitude: _Optional[_Union[_common_pb2.AltitudeReference, str]] = ...) -> None: ...

class SightLine(_message.Message):
    __slots__ = ("id", "a", "b", "fidelity", "priority", "obstruction_distance_m", "range_m", "region")
    ID_FIELD_NUMBER: _ClassVar[int]
    A_FIELD_NUMBER: _ClassVar[int]
    B_FIELD_NUMBER: _ClassVar[int]
    FIDELITY_FIELD_NUMBER: _ClassVar[int]
    PRIORITY_FIELD_NUMBER: _ClassVar[int]
    OBSTRUCTION_DISTANCE_M_FIELD_NUMBER: _ClassVar[int]
    RANGE_M_FIELD_NUMBER: _ClassVar[int]
    REGION_FIELD_NUMBER: _ClassVar[int]
    id: int
    a: Anchor
    b: Anchor
    fidelity: Fidelity
    priority: int
    obstruction_distance_m: float
    range_m: float
    region: Disc
    def __init__(self, id: _Optional[int] = ..., a: _Optional[_Union[Anchor, _Mapping]] = ..., b: _Optional[_Union[Anchor, _Mapping]] = ..., fidelity: _Optional[_Union[Fidelity, str]] = ..., priority: _Optional[int] = ..., obstruction_distance_m: _Optional[float] = ..., range_m: _Optional[float] = ..., region: _Optional[_Union[Disc, _Mapping]] = ...) -> None: ...

class Disc(_message.Message):
    __slots__ = ("centre", "frame", "radius_m")
    CENTRE_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    RADIUS_M_FIELD_NUMBER: _ClassVar[int]
    centre: _common_pb2.Position
    frame: _common_pb2.CoordinateFrame
    radius_m: float
    def __init__(self, centre: _Optional[_Union[_common_pb2.Position, _Mapping]] = ..., frame: _Optional[_Union[_common_pb2.CoordinateFrame, str]] = ..., radius_m: _Optional[float] = ...) -> None: ...

class SightLineState(_message.Message):
    __slots__ = ("id", "resolved", "verdict", "unknown_reason", "fidelity", "obstruction_distance_m", "first_obstruction")
    ID_FIELD_NUMBER: _ClassVar[int]
    RESOLVED_FIELD_NUMBER: _ClassVar[int]
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    UNKNOWN_REASON_FIELD_NUMBER: _ClassVar[int]
    FIDELITY_FIELD_NUMBER: _ClassVar[int]
    OBSTRUCTION_DISTANCE_M_FIELD_NUMBER: _ClassVar[int]
    FIRST_OBSTRUCTION_FIELD_NUMBER: _ClassVar[int]
    id: int
    resolved: _common_pb2.Segment
    verdict: _common_pb2.Verdict
    unknown_reason: _common_pb2.UnknownReason
    fidelity: Fidelity
    obstruction_distance_m: float
    first_obstruction: float
    def __init__(self, id: _Optional[int] = ..., resolved: _Optional[_Union[_common_pb2.Segment, _Mapping]] = ..., verdict: _Optional[_Union[_common_pb2.Verdict, str]] = ..., unknown_reason: _Optional[_Union[_common_pb2.UnknownReason, str]] = ..., fidelity: _Optional[_Union[Fidelity, str]] = ..., obstruction_distance_m: _Optional[float] = ..., first_obstruction: _Optional[float] = ...) -> None: ...

class CreateExerciseRequest(_message.Message):
    __slots__ = ("name", "lease")
    NAME_FIELD_NUMBER: _ClassVar[int]
    LEASE_FIELD_NUMBER: _ClassVar[int]
    name: str
    lease: Lease
    def __init__(self, name: _Optional[str] = ..., lease: _Optional[_Union[Lease, _Mapping]] = ...) -> None: ...

class CreateExerciseResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class ListExercisesRequest(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class ListExercisesResponse(_message.Message):
    __slots__ = ("exercises",)
    EXERCISES_FIELD_NUMBER: _ClassVar[int]
    exercises: _containers.RepeatedCompositeFieldContainer[ExerciseSummary]
    def __init__(self, exercises: _Optional[_Iterable[_Union[ExerciseSummary, _Mapping]]] = ...) -> None: ...

class ExerciseSummary(_message.Message):
    __slots__ = ("name", "epoch", "entities", "sight_lines")
    NAME_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    ENTITIES_FIELD_NUMBER: _ClassVar[int]
    SIGHT_LINES_FIELD_NUMBER: _ClassVar[int]
    name: str
    epoch: int
    entities: int
    sight_lines: int
    def __init__(self, name: _Optional[str] = ..., epoch: _Optional[int] = ..., entities: _Optional[int] = ..., sight_lines: _Optional[int] = ...) -> None: ...

class GetExerciseRequest(_message.Message):
    __slots__ = ("name",)
    NAME_FIELD_NUMBER: _ClassVar[int]
    name: str
    def __init__(self, name: _Optional[str] = ...) -> None: ...

class GetExerciseResponse(_message.Message):
    __slots__ = ("epoch", "entities", "sight_lines", "leases")
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    ENTITIES_FIELD_NUMBER: _ClassVar[int]
    SIGHT_LINES_FIELD_NUMBER: _ClassVar[int]
    LEASES_FIELD_NUMBER: _ClassVar[int]
    epoch: int
    entities: _containers.RepeatedCompositeFieldContainer[Entity]
    sight_lines: _containers.RepeatedCompositeFieldContainer[SightLineState]
    leases: _containers.RepeatedCompositeFieldContainer[LeaseState]
    def __init__(self, epoch: _Optional[int] = ..., entities: _Optional[_Iterable[_Union[Entity, _Mapping]]] = ..., sight_lines: _Optional[_Iterable[_Union[SightLineState, _Mapping]]] = ..., leases: _Optional[_Iterable[_Union[LeaseState, _Mapping]]] = ...) -> None: ...

class ChangeExerciseRequest(_message.Message):
    __slots__ = ("name", "remove_entities", "remove_sight_lines", "put_entities", "put_sight_lines", "lease")
    NAME_FIELD_NUMBER: _ClassVar[int]
    REMOVE_ENTITIES_FIELD_NUMBER: _ClassVar[int]
    REMOVE_SIGHT_LINES_FIELD_NUMBER: _ClassVar[int]
    PUT_ENTITIES_FIELD_NUMBER: _ClassVar[int]
    PUT_SIGHT_LINES_FIELD_NUMBER: _ClassVar[int]
    LEASE_FIELD_NUMBER: _ClassVar[int]
    name: str
    remove_entities: _containers.RepeatedScalarFieldContainer[int]
    remove_sight_lines: _containers.RepeatedScalarFieldContainer[int]
    put_entities: _containers.RepeatedCompositeFieldContainer[Entity]
    put_sight_lines: _containers.RepeatedCompositeFieldContainer[SightLine]
    lease: Lease
    def __init__(self, name: _Optional[str] = ..., remove_entities: _Optional[_Iterable[int]] = ..., remove_sight_lines: _Optional[_Iterable[int]] = ..., put_entities: _Optional[_Iterable[_Union[Entity, _Mapping]]] = ..., put_sight_lines: _Optional[_Iterable[_Union[SightLine, _Mapping]]] = ..., lease: _Optional[_Union[Lease, _Mapping]] = ...) -> None: ...

class ChangeExerciseResponse(_message.Message):
    __slots__ = ("epoch",)
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    epoch: int
    def __init__(self, epoch: _Optional[int] = ...) -> None: ...

class DeleteExerciseRequest(_message.Message):
    __slots__ = ("name",)
    NAME_FIELD_NUMBER: _ClassVar[int]
    name: str
    def __init__(self, name: _Optional[str] = ...) -> None: ...

class DeleteExerciseResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class WatchExerciseRequest(_message.Message):
    __slots__ = ("name", "sight_lines", "lease_owner")
    NAME_FIELD_NUMBER: _ClassVar[int]
    SIGHT_LINES_FIELD_NUMBER: _ClassVar[int]
    LEASE_OWNER_FIELD_NUMBER: _ClassVar[int]
    name: str
    sight_lines: _containers.RepeatedScalarFieldContainer[int]
    lease_owner: str
    def __init__(self, name: _Optional[str] = ..., sight_lines: _Optional[_Iterable[int]] = ..., lease_owner: _Optional[str] = ...) -> None: ...

class WatchExerciseResponse(_message.Message):
    __slots__ = ("epoch", "changed", "removed", "expired_owners")
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    CHANGED_FIELD_NUMBER: _ClassVar[int]
    REMOVED_FIELD_NUMBER: _ClassVar[int]
    EXPIRED_OWNERS_FIELD_NUMBER: _ClassVar[int]
    epoch: int
    changed: _containers.RepeatedCompositeFieldContainer[LineVerdict]
    removed: _containers.RepeatedScalarFieldContainer[int]
    expired_owners: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, epoch: _Optional[int] = ..., changed: _Optional[_Iterable[_Union[LineVerdict, _Mapping]]] = ..., removed: _Optional[_Iterable[int]] = ..., expired_owners: _Optional[_Iterable[str]] = ...) -> None: ...

class LineVerdict(_message.Message):
    __slots__ = ("id", "verdict", "unknown_reason")
    ID_FIELD_NUMBER: _ClassVar[int]
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    UNKNOWN_REASON_FIELD_NUMBER: _ClassVar[int]
    id: int
    verdict: _common_pb2.Verdict
    unknown_reason: _common_pb2.UnknownReason
    def __init__(self, id: _Optional[int] = ..., verdict: _Optional[_Union[_common_pb2.Verdict, str]] = ..., unknown_reason: _Optional[_Union[_common_pb2.UnknownReason, str]] = ...) -> None: ...

class RenewLeaseRequest(_message.Message):
    __slots__ = ("name", "owner")
    NAME_FIELD_NUMBER: _ClassVar[int]
    OWNER_FIELD_NUMBER: _ClassVar[int]
    name: str
    owner: str
    def __init__(self, name: _Optional[str] = ..., owner: _Optional[str] = ...) -> None: ...

class RenewLeaseResponse(_message.Message):
    __slots__ = ("term_s",)
    TERM_S_FIELD_NUMBER: _ClassVar[int]
    term_s: int
    def __init__(self, term_s: _Optional[int] = ...) -> None: ...
