from sightline.v1 import common_pb2 as _common_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class DescribeTerrainRequest(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class DescribeTerrainResponse(_message.Message):
    __slots__ = ("terrain",)
    TERRAIN_FIELD_NUMBER: _ClassVar[int]
    terrain: TerrainDescription
    def __init__(self, terrain: _Optional[_Union[TerrainDescription, _Mapping]] = ...) -> None: ...

class TerrainDescription(_message.Message):
    __slots__ = ("version", "nx", "ny", "root_exponent", "metres_per_post_east", "metres_per_post_north", "metres_per_height_unit", "min_height", "max_height", "void_posts", "map_origin_x", "map_origin_y", "map_step_x", "map_step_y", "epsg", "geographic", "corner_heights")
    VERSION_FIELD_NUMBER: _ClassVar[int]
    NX_FIELD_NUMBER: _ClassVar[int]
    NY_FIELD_NUMBER: _ClassVar[int]
    ROOT_EXPONENT_FIELD_NUMBER: _ClassVar[int]
    METRES_PER_POST_EAST_FIELD_NUMBER: _ClassVar[int]
    METRES_PER_POST_NORTH_FIELD_NUMBER: _ClassVar[int]
    METRES_PER_HEIGHT_UNIT_FIELD_NUMBER: _ClassVar[int]
    MIN_HEIGHT_FIELD_NUMBER: _ClassVar[int]
    MAX_HEIGHT_FIELD_NUMBER: _ClassVar[int]
    VOID_POSTS_FIELD_NUMBER: _ClassVar[int]
    MAP_ORIGIN_X_FIELD_NUMBER: _ClassVar[int]
    MAP_ORIGIN_Y_FIELD_NUMBER: _ClassVar[int]
    MAP_STEP_X_FIELD_NUMBER: _ClassVar[int]
    MAP_STEP_Y_FIELD_NUMBER: _ClassVar[int]
    EPSG_FIELD_NUMBER: _ClassVar[int]
    GEOGRAPHIC_FIELD_NUMBER: _ClassVar[int]
    CORNER_HEIGHTS_FIELD_NUMBER: _ClassVar[int]
    version: bytes
    nx: int
    ny: int
    root_exponent: int
    metres_per_post_east: float
    metres_per_post_north: float
    metres_per_height_unit: float
    min_height: float
    max_height: float
    void_posts: int
    map_origin_x: float
    map_origin_y: float
    map_step_x: float
    map_step_y: float
    epsg: int
    geographic: bool
    corner_heights: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, version: _Optional[bytes] = ..., nx: _Optional[int] = ..., ny: _Optional[int] = ..., root_exponent: _Optional[int] = ..., metres_per_post_east: _Optional[float] = ..., metres_per_post_north: _Optional[float] = ..., metres_per_height_unit: _Optional[float] = ..., min_height: _Optional[float] = ..., max_height: _Optional[float] = ..., void_posts: _Optional[int] = ..., map_origin_x: _Optional[float] = ..., map_origin_y: _Optional[float] = ..., map_step_x: _Optional[float] = ..., map_step_y: _Optional[float] = ..., epsg: _Optional[int] = ..., geographic: bool = ..., corner_heights: _Optional[_Iterable[int]] = ...) -> None: ...

class GetHeightsRequest(_message.Message):
    __slots__ = ("frame", "x", "y", "normals")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    NORMALS_FIELD_NUMBER: _ClassVar[int]
    frame: _common_pb2.CoordinateFrame
    x: _containers.RepeatedScalarFieldContainer[float]
    y: _containers.RepeatedScalarFieldContainer[float]
    normals: bool
    def __init__(self, frame: _Optional[_Union[_common_pb2.CoordinateFrame, str]] = ..., x: _Optional[_Iterable[float]] = ..., y: _Optional[_Iterable[float]] = ..., normals: bool = ...) -> None: ...

class GetHeightsResponse(_message.Message):
    __slots__ = ("z", "known", "normal_east", "normal_north", "normal_up")
    Z_FIELD_NUMBER: _ClassVar[int]
    KNOWN_FIELD_NUMBER: _ClassVar[int]
    NORMAL_EAST_FIELD_NUMBER: _ClassVar[int]
    NORMAL_NORTH_FIELD_NUMBER: _ClassVar[int]
    NORMAL_UP_FIELD_NUMBER: _ClassVar[int]
    z: _containers.RepeatedScalarFieldContainer[float]
    known: _containers.RepeatedScalarFieldContainer[bool]
    normal_east: _containers.RepeatedScalarFieldContainer[float]
    normal_north: _containers.RepeatedScalarFieldContainer[float]
    normal_up: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, z: _Optional[_Iterable[float]] = ..., known: _Optional[_Iterable[bool]] = ..., normal_east: _Optional[_Iterable[float]] = ..., normal_north: _Optional[_Iterable[float]] = ..., normal_up: _Optional[_Iterable[float]] = ...) -> None: ...
