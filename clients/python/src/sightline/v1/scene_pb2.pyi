from sightline.v1 import common_pb2 as _common_pb2
from sightline.v1 import exercise_pb2 as _exercise_pb2
from sightline.v1 import terrain_pb2 as _terrain_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class UnsatisfiedReason(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    UNSATISFIED_REASON_UNSPECIFIED: _ClassVar[UnsatisfiedReason]
    UNSATISFIED_REASON_BUDGET: _ClassVar[UnsatisfiedReason]
UNSATISFIED_REASON_UNSPECIFIED: UnsatisfiedReason
UNSATISFIED_REASON_BUDGET: UnsatisfiedReason

class StreamSceneRequest(_message.Message):
    __slots__ = ("open", "steer", "snapshot")
    OPEN_FIELD_NUMBER: _ClassVar[int]
    STEER_FIELD_NUMBER: _ClassVar[int]
    SNAPSHOT_FIELD_NUMBER: _ClassVar[int]
    open: OpenView
    steer: SteerView
    snapshot: RequestSnapshot
    def __init__(self, open: _Optional[_Union[OpenView, _Mapping]] = ..., steer: _Optional[_Union[SteerView, _Mapping]] = ..., snapshot: _Optional[_Union[RequestSnapshot, _Mapping]] = ...) -> None: ...

class StreamSceneResponse(_message.Message):
    __slots__ = ("opened", "exercise", "frame")
    OPENED_FIELD_NUMBER: _ClassVar[int]
    EXERCISE_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    opened: ViewOpened
    exercise: ExerciseUpdate
    frame: Frame
    def __init__(self, opened: _Optional[_Union[ViewOpened, _Mapping]] = ..., exercise: _Optional[_Union[ExerciseUpdate, _Mapping]] = ..., frame: _Optional[_Union[Frame, _Mapping]] = ...) -> None: ...

class OpenView(_message.Message):
    __slots__ = ("exercise", "settings", "pose", "lease_owner", "pace")
    EXERCISE_FIELD_NUMBER: _ClassVar[int]
    SETTINGS_FIELD_NUMBER: _ClassVar[int]
    POSE_FIELD_NUMBER: _ClassVar[int]
    LEASE_OWNER_FIELD_NUMBER: _ClassVar[int]
    PACE_FIELD_NUMBER: _ClassVar[int]
    exercise: str
    settings: ViewSettings
    pose: Pose
    lease_owner: str
    pace: Pace
    def __init__(self, exercise: _Optional[str] = ..., settings: _Optional[_Union[ViewSettings, _Mapping]] = ..., pose: _Optional[_Union[Pose, _Mapping]] = ..., lease_owner: _Optional[str] = ..., pace: _Optional[_Union[Pace, _Mapping]] = ...) -> None: ...

class SteerView(_message.Message):
    __slots__ = ("pose", "pose_sequence", "applied_sequence", "settings", "frame_time_ms", "pace")
    POSE_FIELD_NUMBER: _ClassVar[int]
    POSE_SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    APPLIED_SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    SETTINGS_FIELD_NUMBER: _ClassVar[int]
    FRAME_TIME_MS_FIELD_NUMBER: _ClassVar[int]
    PACE_FIELD_NUMBER: _ClassVar[int]
    pose: Pose
    pose_sequence: int
    applied_sequence: int
    settings: ViewSettings
    frame_time_ms: float
    pace: Pace
    def __init__(self, pose: _Optional[_Union[Pose, _Mapping]] = ..., pose_sequence: _Optional[int] = ..., applied_sequence: _Optional[int] = ..., settings: _Optional[_Union[ViewSettings, _Mapping]] = ..., frame_time_ms: _Optional[float] = ..., pace: _Optional[_Union[Pace, _Mapping]] = ...) -> None: ...

class Pace(_message.Message):
    __slots__ = ("max_rate_hz", "max_bytes_per_s")
    MAX_RATE_HZ_FIELD_NUMBER: _ClassVar[int]
    MAX_BYTES_PER_S_FIELD_NUMBER: _ClassVar[int]
    max_rate_hz: float
    max_bytes_per_s: int
    def __init__(self, max_rate_hz: _Optional[float] = ..., max_bytes_per_s: _Optional[int] = ...) -> None: ...

class RequestSnapshot(_message.Message):
    __slots__ = ("received_sequence",)
    RECEIVED_SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    received_sequence: int
    def __init__(self, received_sequence: _Optional[int] = ...) -> None: ...

class Pose(_message.Message):
    __slots__ = ("eye", "rotation")
    EYE_FIELD_NUMBER: _ClassVar[int]
    ROTATION_FIELD_NUMBER: _ClassVar[int]
    eye: _common_pb2.Position
    rotation: Quaternion
    def __init__(self, eye: _Optional[_Union[_common_pb2.Position, _Mapping]] = ..., rotation: _Optional[_Union[Quaternion, _Mapping]] = ...) -> None: ...

class Quaternion(_message.Message):
    __slots__ = ("x", "y", "z", "w")
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    Z_FIELD_NUMBER: _ClassVar[int]
    W_FIELD_NUMBER: _ClassVar[int]
    x: float
    y: float
    z: float
    w: float
    def __init__(self, x: _Optional[float] = ..., y: _Optional[float] = ..., z: _Optional[float] = ..., w: _Optional[float] = ...) -> None: ...

class ViewSettings(_message.Message):
    __slots__ = ("perspective", "orthographic", "viewport_width_px", "viewport_height_px", "triangle_budget", "screen_error", "frame_time", "subscription", "regions")
    PERSPECTIVE_FIELD_NUMBER: _ClassVar[int]
    ORTHOGRAPHIC_FIELD_NUMBER: _ClassVar[int]
    VIEWPORT_WIDTH_PX_FIELD_NUMBER: _ClassVar[int]
    VIEWPORT_HEIGHT_PX_FIELD_NUMBER: _ClassVar[int]
    TRIANGLE_BUDGET_FIELD_NUMBER: _ClassVar[int]
    SCREEN_ERROR_FIELD_NUMBER: _ClassVar[int]
    FRAME_TIME_FIELD_NUMBER: _ClassVar[int]
    SUBSCRIPTION_FIELD_NUMBER: _ClassVar[int]
    REGIONS_FIELD_NUMBER: _ClassVar[int]
    perspective: Perspective
    orthographic: Orthographic
    viewport_width_px: int
    viewport_height_px: int
    triangle_budget: TriangleBudget
    screen_error: ScreenError
    frame_time: FrameTime
    subscription: Subscription
    regions: _containers.RepeatedCompositeFieldContainer[RegionOfInterest]
    def __init__(self, perspective: _Optional[_Union[Perspective, _Mapping]] = ..., orthographic: _Optional[_Union[Orthographic, _Mapping]] = ..., viewport_width_px: _Optional[int] = ..., viewport_height_px: _Optional[int] = ..., triangle_budget: _Optional[_Union[TriangleBudget, _Mapping]] = ..., screen_error: _Optional[_Union[ScreenError, _Mapping]] = ..., frame_time: _Optional[_Union[FrameTime, _Mapping]] = ..., subscription: _Optional[_Union[Subscription, _Mapping]] = ..., regions: _Optional[_Iterable[_Union[RegionOfInterest, _Mapping]]] = ...) -> None: ...

class RegionOfInterest(_message.Message):
    __slots__ = ("east_m", "north_m", "radius_m", "weight")
    EAST_M_FIELD_NUMBER: _ClassVar[int]
    NORTH_M_FIELD_NUMBER: _ClassVar[int]
    RADIUS_M_FIELD_NUMBER: _ClassVar[int]
    WEIGHT_FIELD_NUMBER: _ClassVar[int]
    east_m: float
    north_m: float
    radius_m: float
    weight: float
    def __init__(self, east_m: _Optional[float] = ..., north_m: _Optional[float] = ..., radius_m: _Optional[float] = ..., weight: _Optional[float] = ...) -> None: ...

class Perspective(_message.Message):
    __slots__ = ("tan_half_fov", "near_m")
    TAN_HALF_FOV_FIELD_NUMBER: _ClassVar[int]
    NEAR_M_FIELD_NUMBER: _ClassVar[int]
    tan_half_fov: float
    near_m: float
    def __init__(self, tan_half_fov: _Optional[float] = ..., near_m: _Optional[float] = ...) -> None: ...

class Orthographic(_message.Message):
    __slots__ = ("half_height_m", "near_m")
    HALF_HEIGHT_M_FIELD_NUMBER: _ClassVar[int]
    NEAR_M_FIELD_NUMBER: _ClassVar[int]
    half_height_m: float
    near_m: float
    def __init__(self, half_height_m: _Optional[float] = ..., near_m: _Optional[float] = ...) -> None: ...

class TriangleBudget(_message.Message):
    __slots__ = ("triangles",)
    TRIANGLES_FIELD_NUMBER: _ClassVar[int]
    triangles: int
    def __init__(self, triangles: _Optional[int] = ...) -> None: ...

class ScreenError(_message.Message):
    __slots__ = ("pixels", "max_triangles")
    PIXELS_FIELD_NUMBER: _ClassVar[int]
    MAX_TRIANGLES_FIELD_NUMBER: _ClassVar[int]
    pixels: float
    max_triangles: int
    def __init__(self, pixels: _Optional[float] = ..., max_triangles: _Optional[int] = ...) -> None: ...

class FrameTime(_message.Message):
    __slots__ = ("milliseconds", "max_triangles")
    MILLISECONDS_FIELD_NUMBER: _ClassVar[int]
    MAX_TRIANGLES_FIELD_NUMBER: _ClassVar[int]
    milliseconds: float
    max_triangles: int
    def __init__(self, milliseconds: _Optional[float] = ..., max_triangles: _Optional[int] = ...) -> None: ...

class Subscription(_message.Message):
    __slots__ = ("all", "none", "list")
    ALL_FIELD_NUMBER: _ClassVar[int]
    NONE_FIELD_NUMBER: _ClassVar[int]
    LIST_FIELD_NUMBER: _ClassVar[int]
    all: AllLines
    none: NoLines
    list: LineList
    def __init__(self, all: _Optional[_Union[AllLines, _Mapping]] = ..., none: _Optional[_Union[NoLines, _Mapping]] = ..., list: _Optional[_Union[LineList, _Mapping]] = ...) -> None: ...

class AllLines(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class NoLines(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class LineList(_message.Message):
    __slots__ = ("ids",)
    IDS_FIELD_NUMBER: _ClassVar[int]
    ids: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, ids: _Optional[_Iterable[int]] = ...) -> None: ...

class ViewOpened(_message.Message):
    __slots__ = ("terrain",)
    TERRAIN_FIELD_NUMBER: _ClassVar[int]
    terrain: _terrain_pb2.TerrainDescription
    def __init__(self, terrain: _Optional[_Union[_terrain_pb2.TerrainDescription, _Mapping]] = ...) -> None: ...

class ExerciseUpdate(_message.Message):
    __slots__ = ("epoch", "changed", "removed")
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    CHANGED_FIELD_NUMBER: _ClassVar[int]
    REMOVED_FIELD_NUMBER: _ClassVar[int]
    epoch: int
    changed: _containers.RepeatedCompositeFieldContainer[_exercise_pb2.SightLineState]
    removed: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, epoch: _Optional[int] = ..., changed: _Optional[_Iterable[_Union[_exercise_pb2.SightLineState, _Mapping]]] = ..., removed: _Optional[_Iterable[int]] = ...) -> None: ...

class UnsatisfiedLine(_message.Message):
    __slots__ = ("id", "reason", "lacking_triangles")
    ID_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    LACKING_TRIANGLES_FIELD_NUMBER: _ClassVar[int]
    id: int
    reason: UnsatisfiedReason
    lacking_triangles: int
    def __init__(self, id: _Optional[int] = ..., reason: _Optional[_Union[UnsatisfiedReason, str]] = ..., lacking_triangles: _Optional[int] = ...) -> None: ...

class Frame(_message.Message):
    __slots__ = ("sequence", "base_sequence", "pose_sequence", "epoch", "mesh", "triangle_count", "distortion_bound_px", "mesh_hash", "now_unsatisfied", "no_longer_unsatisfied", "now_off_ground", "no_longer_off_ground", "held_back_ms")
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    BASE_SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    POSE_SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    MESH_FIELD_NUMBER: _ClassVar[int]
    TRIANGLE_COUNT_FIELD_NUMBER: _ClassVar[int]
    DISTORTION_BOUND_PX_FIELD_NUMBER: _ClassVar[int]
    MESH_HASH_FIELD_NUMBER: _ClassVar[int]
    NOW_UNSATISFIED_FIELD_NUMBER: _ClassVar[int]
    NO_LONGER_UNSATISFIED_FIELD_NUMBER: _ClassVar[int]
    NOW_OFF_GROUND_FIELD_NUMBER: _ClassVar[int]
    NO_LONGER_OFF_GROUND_FIELD_NUMBER: _ClassVar[int]
    HELD_BACK_MS_FIELD_NUMBER: _ClassVar[int]
    sequence: int
    base_sequence: int
    pose_sequence: int
    epoch: int
    mesh: bytes
    triangle_count: int
    distortion_bound_px: float
    mesh_hash: int
    now_unsatisfied: _containers.RepeatedCompositeFieldContainer[UnsatisfiedLine]
    no_longer_unsatisfied: _containers.RepeatedScalarFieldContainer[int]
    now_off_ground: _containers.RepeatedScalarFieldContainer[int]
    no_longer_off_ground: _containers.RepeatedScalarFieldContainer[int]
    held_back_ms: int
    def __init__(self, sequence: _Optional[int] = ..., base_sequence: _Optional[int] = ..., pose_sequence: _Optional[int] = ..., epoch: _Optional[int] = ..., mesh: _Optional[bytes] = ..., triangle_count: _Optional[int] = ..., distortion_bound_px: _Optional[float] = ..., mesh_hash: _Optional[int] = ..., now_unsatisfied: _Optional[_Iterable[_Union[UnsatisfiedLine, _Mapping]]] = ..., no_longer_unsatisfied: _Optional[_Iterable[int]] = ..., now_off_ground: _Optional[_Iterable[int]] = ..., no_longer_off_ground: _Optional[_Iterable[int]] = ..., held_back_ms: _Optional[int] = ...) -> None: ...

class WatchViewsRequest(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class WatchViewsResponse(_message.Message):
    __slots__ = ("begun", "message", "closed")
    BEGUN_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    CLOSED_FIELD_NUMBER: _ClassVar[int]
    begun: WatchBegun
    message: WatchedViewMessage
    closed: WatchedViewClosed
    def __init__(self, begun: _Optional[_Union[WatchBegun, _Mapping]] = ..., message: _Optional[_Union[WatchedViewMessage, _Mapping]] = ..., closed: _Optional[_Union[WatchedViewClosed, _Mapping]] = ...) -> None: ...

class WatchBegun(_message.Message):
    __slots__ = ("watch_id",)
    WATCH_ID_FIELD_NUMBER: _ClassVar[int]
    watch_id: str
    def __init__(self, watch_id: _Optional[str] = ...) -> None: ...

class WatchedViewMessage(_message.Message):
    __slots__ = ("view_id", "message")
    VIEW_ID_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    view_id: int
    message: StreamSceneResponse
    def __init__(self, view_id: _Optional[int] = ..., message: _Optional[_Union[StreamSceneResponse, _Mapping]] = ...) -> None: ...

class WatchedViewClosed(_message.Message):
    __slots__ = ("view_id", "code", "reason")
    VIEW_ID_FIELD_NUMBER: _ClassVar[int]
    CODE_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    view_id: int
    code: int
    reason: str
    def __init__(self, view_id: _Optional[int] = ..., code: _Optional[int] = ..., reason: _Optional[str] = ...) -> None: ...

class OpenWatchedViewRequest(_message.Message):
    __slots__ = ("watch_id", "view_id", "open")
    WATCH_ID_FIELD_NUMBER: _ClassVar[int]
    VIEW_ID_FIELD_NUMBER: _ClassVar[int]
    OPEN_FIELD_NUMBER: _ClassVar[int]
    watch_id: str
    view_id: int
    open: OpenView
    def __init__(self, watch_id: _Optional[str] = ..., view_id: _Optional[int] = ..., open: _Optional[_Union[OpenView, _Mapping]] = ...) -> None: ...

class OpenWatchedViewResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class TellWatchedViewRequest(_message.Message):
    __slots__ = ("watch_id", "view_id", "steer", "snapshot")
    WATCH_ID_FIELD_NUMBER: _ClassVar[int]
    VIEW_ID_FIELD_NUMBER: _ClassVar[int]
    STEER_FIELD_NUMBER: _ClassVar[int]
    SNAPSHOT_FIELD_NUMBER: _ClassVar[int]
    watch_id: str
    view_id: int
    steer: SteerView
    snapshot: RequestSnapshot
    def __init__(self, watch_id: _Optional[str] = ..., view_id: _Optional[int] = ..., steer: _Optional[_Union[SteerView, _Mapping]] = ..., snapshot: _Optional[_Union[RequestSnapshot, _Mapping]] = ...) -> None: ...

class TellWatchedViewResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class CloseWatchedViewRequest(_message.Message):
    __slots__ = ("watch_id", "view_id")
    WATCH_ID_FIELD_NUMBER: _ClassVar[int]
    VIEW_ID_FIELD_NUMBER: _ClassVar[int]
    watch_id: str
    view_id: int
    def __init__(self, watch_id: _Optional[str] = ..., view_id: _Optional[int] = ...) -> None: ...

class CloseWatchedViewResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...
