"""Messages of `sightline.v1` to and from the types of this package. Without I/O."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, cast

import grpc
import numpy as np
import numpy.typing as npt

from .errors import ProtocolError, Refused
from .types import (
    Altitude,
    AtEntity,
    AtPoint,
    Bools,
    Disc,
    Entity,
    Exercise,
    Fidelity,
    Floats,
    Frame,
    GroundState,
    Heights,
    Horizon,
    Lease,
    LeaseState,
    LimitUse,
    LineOfSight,
    LinesOfSight,
    LineState,
    Obstruction,
    Point,
    Precision,
    Profile,
    Ray,
    RayEnd,
    Recording,
    SightLine,
    State,
    StatedLine,
    Status,
    Stretch,
    Terrain,
    UnknownReason,
    Verdict,
    VerdictNews,
    Verdicts,
    Viewshed,
)
from .v1 import common_pb2 as common
from .v1 import exercise_pb2 as exercise_wire
from .v1 import line_of_sight_pb2 as los
from .v1 import operation_pb2 as operation
from .v1 import terrain_pb2 as terrain_wire

_FRAMES = {
    "map": common.COORDINATE_FRAME_MAP,
    "grid": common.COORDINATE_FRAME_GRID,
    "geographic": common.COORDINATE_FRAME_GEOGRAPHIC,
    "scene": common.COORDINATE_FRAME_SCENE,
}
_ALTITUDES = {"absolute": common.ALTITUDE_REFERENCE_ABSOLUTE, "agl": common.ALTITUDE_REFERENCE_ABOVE_GROUND}
_PRECISIONS = {"exact": los.PRECISION_EXACT, "f64": los.PRECISION_F64, "fast": los.PRECISION_FAST}
TILE_POSTS = 64
"""Side of a tile of a viewshed."""


# --- questions


def frame(name: Frame) -> common.CoordinateFrame:
    """The number of a frame."""
    if name not in _FRAMES:
        raise ValueError(f"frame {name!r} is none of {', '.join(_FRAMES)}")
    return _FRAMES[name]


def altitude(name: Altitude) -> common.AltitudeReference:
    """The number of an altitude reference."""
    if name not in _ALTITUDES:
        raise ValueError(f"altitude {name!r} is none of {', '.join(_ALTITUDES)}")
    return _ALTITUDES[name]


def options(precision: Precision | float, earth: float | None = None) -> los.QueryOptions:
    """A precision by name, or a tolerance in height units; and the radius of the Earth in metres, None for flat."""
    wire = los.QueryOptions()
    if isinstance(precision, str):
        if precision not in _PRECISIONS:
            raise ValueError(f"precision {precision!r} is neither a tolerance nor one of {', '.join(_PRECISIONS)}")
        wire.precision = _PRECISIONS[precision]
    else:
        wire.precision, wire.tolerance = los.PRECISION_TOLERANCE, precision
    if earth is not None:
        wire.sphere.radius_m = earth
    return wire


def position(point: Point) -> common.Position:
    """Three numbers as a message."""
    numbers = np.asarray(point, dtype=np.float64)
    if numbers.shape != (3,):
        raise ValueError(f"a position is three numbers; here it is {point!r}")
    x, y, z = numbers.tolist()
    return common.Position(x=x, y=y, z=z)


def end(point: Point, of: Frame, above: Altitude) -> los.SightLineEnd:
    """One end of a queried line."""
    return los.SightLineEnd(position=position(point), frame=frame(of), altitude=altitude(above))


def columns(points: npt.ArrayLike, width: int) -> Floats:
    """Positions as an array of shape (n, width)."""
    array = np.asarray(points, dtype=np.float64)
    if array.ndim == 1 and array.size == 0:
        array = array.reshape(0, width)
    if array.ndim != 2 or array.shape[1] != width:
        raise ValueError(f"positions are an array of shape (n, {width}); here it is {array.shape}")
    return array


def batch(
    a: Floats, b: Floats, of: Frame, above: Altitude, strict: bool, how: los.QueryOptions
) -> los.QueryLineOfSightBatchRequest:
    """Lines from (n, 3) to (n, 3)."""
    wire = los.QueryLineOfSightBatchRequest(frame=frame(of), altitude=altitude(above), strict=strict, options=how)
    for name, values in zip(("ax", "ay", "az", "bx", "by", "bz"), np.hstack([a, b]).T, strict=True):
        getattr(wire, name).extend(values.tolist())
    return wire


def entity(given: Entity) -> exercise_wire.Entity:
    """An entity."""
    return exercise_wire.Entity(
        id=given.id,
        position=position(given.position),
        frame=frame(given.frame),
        altitude=altitude(given.altitude),
        ground_m=given.ground_m,
    )


def _disc(given: Disc) -> exercise_wire.Disc:
    x, y = np.asarray(given.centre, dtype=np.float64).tolist()
    return exercise_wire.Disc(centre=common.Position(x=x, y=y), frame=frame(given.frame), radius_m=given.radius_m)


def _anchor(given: AtEntity | AtPoint) -> exercise_wire.Anchor:
    if isinstance(given, AtEntity):
        return exercise_wire.Anchor(
            entity=exercise_wire.EntityAnchor(entity_id=given.entity_id, height_offset_m=given.height_offset_m)
        )
    point = exercise_wire.PointAnchor(
        position=position(given.position), frame=frame(given.frame), altitude=altitude(given.altitude)
    )
    return exercise_wire.Anchor(point=point)


def sight_line(given: SightLine) -> exercise_wire.SightLine:
    """A sight line to register."""
    return exercise_wire.SightLine(
        id=given.id,
        a=_anchor(given.a),
        b=_anchor(given.b),
        fidelity=cast(exercise_wire.Fidelity, int(given.fidelity)),
        priority=given.priority,
        obstruction_distance_m=given.obstruction_distance_m,
        range_m=given.range_m,
        region=None if given.region is None else _disc(given.region),
    )


# --- answers


def _triple(p: common.Position) -> Floats:
    return np.array([p.x, p.y, p.z])


def _segment(s: common.Segment) -> Floats:
    return np.array([_triple(s.a), _triple(s.b)])


def _verdict(number: int) -> Verdict:
    try:
        return Verdict(number)
    except ValueError:
        raise ProtocolError(f"{number} is no verdict") from None


def verdicts(numbers: Iterable[int]) -> Verdicts:
    """Verdicts of the wire as an array, each checked."""
    array = np.fromiter(numbers, dtype=np.int8)
    if ((array < 1) | (array > 3)).any():
        raise ProtocolError("a number that is no verdict")
    return array


def _floats(values: Sequence[float], known: Bools | None = None) -> Floats:
    array = np.array(values, dtype=np.float64)
    return array if known is None else np.where(known, array, np.nan)


def _same_length(*parts: Sequence[object]) -> None:
    if len({len(part) for part in parts}) > 1:
        raise ProtocolError("columns of different lengths")


def terrain(wire: terrain_wire.TerrainDescription) -> Terrain:
    """The description of a terrain."""
    return Terrain(
        version=wire.version.hex(),
        nx=wire.nx,
        ny=wire.ny,
        root_exponent=wire.root_exponent,
        scale=(wire.metres_per_post_east, wire.metres_per_post_north, wire.metres_per_height_unit),
        heights=(wire.min_height, wire.max_height),
        void_posts=wire.void_posts,
        origin=(wire.map_origin_x, wire.map_origin_y),
        step=(wire.map_step_x, wire.map_step_y),
        epsg=wire.epsg or None,
        geographic=wire.geographic,
        corner_heights=tuple(wire.corner_heights),
    )


def heights(wire: terrain_wire.GetHeightsResponse, normals: bool) -> Heights:
    """Heights of the ground."""
    _same_length(wire.z, wire.known)
    parts = (wire.normal_east, wire.normal_north, wire.normal_up)
    if normals:
        _same_length(wire.z, *parts)
    known = np.array(wire.known, dtype=np.bool_)
    return Heights(_floats(wire.z, known), np.column_stack([_floats(p) for p in parts]) if normals else None)


def status(wire: operation.GetStatusResponse) -> Status:
    """How a server is."""
    plain = {field.name: getattr(wire, field.name) for field in wire.DESCRIPTOR.fields}
    limits = {use.name: LimitUse(use.used, use.limit) for use in wire.limits}
    of = wire.recording
    recording = Recording(of.bytes, of.limit_bytes, of.ended) if wire.HasField("recording") else None
    return Status(**plain | {"troubles": tuple(wire.troubles), "limits": limits, "recording": recording})


def _obstruction(wire: los.Obstruction) -> Obstruction:
    return Obstruction(_triple(wire.position), wire.range_m)


def _stretches(state: Callable[[int], State], wire: Iterable[Any]) -> tuple[Stretch[State], ...]:
    try:
        return tuple(Stretch(getattr(s, "from"), s.to, state(s.state)) for s in wire)
    except ValueError as error:
        raise ProtocolError(f"a stretch of a line: {error}") from None


def line_of_sight(wire: los.QueryLineOfSightResponse) -> LineOfSight:
    """The answer to one line."""

    def given(name: str) -> bool:
        return wire.HasField(name)

    return LineOfSight(
        verdict=_verdict(wire.verdict),
        unknown_reason=UnknownReason(wire.unknown_reason),
        ends=_segment(wire.resolved) if given("resolved") else None,
        grazes=wire.grazes,
        certain=wire.certain,
        range_m=wire.range_m,
        sagitta_m=wire.sagitta_m,
        first_from_a=_obstruction(wire.first_from_a) if given("first_from_a") else None,
        first_from_b=_obstruction(wire.first_from_b) if given("first_from_b") else None,
        least_clearance=wire.least_clearance if given("least_clearance") else None,
        deepest=wire.deepest if given("deepest") else None,
        least_target_z=wire.least_target_z if given("least_target_z") else None,
        line=_stretches(LineState, wire.line),
        ground=_stretches(GroundState, wire.ground),
    )


def lines_of_sight(chunks: Sequence[los.QueryLineOfSightBatchResponse], asked: int) -> LinesOfSight:
    """The chunks of answers to a batch of `asked` lines."""
    due = 0
    for chunk in chunks:
        _same_length(chunk.verdicts, chunk.grazes, chunk.certain)
        if chunk.first_index != due:
            raise ProtocolError("a chunk of answers that does not follow the one before")
        due += len(chunk.verdicts)
    if due != asked:
        raise ProtocolError(f"{due} answers to {asked} lines")
    return LinesOfSight(
        verdicts=verdicts(v for chunk in chunks for v in chunk.verdicts),
        grazes=np.fromiter((g for chunk in chunks for g in chunk.grazes), dtype=np.bool_),
        certain=np.fromiter((c for chunk in chunks for c in chunk.certain), dtype=np.bool_),
    )


def group(wire: los.StreamLinesOfSightResponse) -> tuple[npt.NDArray[np.uint64], LinesOfSight | Refused]:
    """The answers to one group of a stream of lines, or why it has none."""
    ids = np.array(wire.ids, dtype=np.uint64)
    if wire.HasField("refusal"):
        names = {code.value[0]: code.name for code in grpc.StatusCode}
        return ids, Refused(names.get(wire.refusal.code, "UNKNOWN"), wire.refusal.message)
    _same_length(wire.ids, wire.verdicts, wire.grazes, wire.certain)
    grazes, certain = (np.array(column, dtype=np.bool_) for column in (wire.grazes, wire.certain))
    return ids, LinesOfSight(verdicts(wire.verdicts), grazes, certain)


def ray(wire: los.QueryRayResponse) -> Ray:
    """What a ray meets."""
    try:
        how = RayEnd(wire.end)
    except ValueError:
        raise ProtocolError(f"{wire.end} is no end of a ray") from None
    hit = how is RayEnd.HIT
    return Ray(
        end=how,
        segment=_segment(wire.resolved) if wire.HasField("resolved") else None,
        hit=_triple(wire.hit) if hit else None,
        range_m=wire.range_m if hit else None,
        normal=_triple(wire.normal) if hit and wire.HasField("normal") else None,
        over_unknown=wire.over_unknown,
    )


def horizon(wire: los.QueryHorizonResponse, azimuths_deg: Floats) -> Horizon:
    """The crest around an observer."""
    _same_length(wire.known, wire.elevation_deg, wire.range_m, wire.over_unknown)
    known = np.array(wire.known, dtype=np.bool_)
    return Horizon(
        azimuths_deg=azimuths_deg,
        elevation_deg=_floats(wire.elevation_deg, known),
        range_m=_floats(wire.range_m, known),
        over_unknown=np.array(wire.over_unknown, dtype=np.bool_),
        below_ground=wire.below_ground,
    )


def profile(wire: los.QueryProfileResponse) -> Profile:
    """The ground under a line."""
    _same_length(wire.t, wire.x, wire.y, wire.ground, wire.known, wire.known_after, wire.bulge or wire.t)
    return Profile(
        t=_floats(wire.t),
        x=_floats(wire.x),
        y=_floats(wire.y),
        ground=_floats(wire.ground, np.array(wire.known, dtype=np.bool_)),
        known_after=np.array(wire.known_after, dtype=np.bool_),
        bulge=_floats(wire.bulge) if wire.bulge else np.zeros(len(wire.t)),
    )


def viewshed(tiles: Sequence[los.QueryViewshedResponse], ground: Terrain) -> Viewshed:
    """The tiles of a viewshed as one array, cut to the region."""
    if any(len(tile.cells) != TILE_POSTS**2 for tile in tiles):
        raise ProtocolError(f"a tile of a viewshed has {TILE_POSTS} x {TILE_POSTS} cells")
    if any(tile.first_i >= ground.nx or tile.first_j >= ground.ny for tile in tiles):
        raise ProtocolError("a tile of a viewshed beyond the grid")
    i0, j0 = min((t.first_i for t in tiles), default=0), min((t.first_j for t in tiles), default=0)
    i1, j1 = max((t.first_i for t in tiles), default=0), max((t.first_j for t in tiles), default=0)
    cells = np.zeros((j1 - j0 + TILE_POSTS, i1 - i0 + TILE_POSTS), dtype=np.int8)
    for tile in tiles:
        j, i = tile.first_j - j0, tile.first_i - i0
        part = np.frombuffer(tile.cells, dtype=np.int8).reshape(TILE_POSTS, TILE_POSTS)
        cells[j : j + TILE_POSTS, i : i + TILE_POSTS] = part
    if ((cells < 0) | (cells > 3)).any():
        raise ProtocolError("a cell of a viewshed that is no verdict")
    rows, cols = np.flatnonzero(cells.any(axis=1)), np.flatnonzero(cells.any(axis=0))
    if rows.size:
        cells = cells[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1].copy()
        return Viewshed(cells, i0 + int(cols[0]), j0 + int(rows[0]), ground)
    return Viewshed(cells[:0, :0], i0, j0, ground)


def intervisibility(rows: Sequence[los.QueryIntervisibilityResponse], points: int) -> Verdicts:
    """Rows of an upper triangle as a symmetric (n, n) matrix; the diagonal is 0."""
    matrix = np.zeros((points, points), dtype=np.int8)
    for due, row in enumerate(rows):
        if row.row != due or due >= points or len(row.verdicts) != points - due - 1:
            raise ProtocolError("a row of a matrix that does not follow the one before")
        matrix[due, due + 1 :] = verdicts(row.verdicts)
    return matrix + matrix.T


def stated_line(state: exercise_wire.SightLineState) -> StatedLine:
    """A registered sight line at one epoch."""
    ends = None
    if state.HasField("resolved"):
        a, b = state.resolved.a, state.resolved.b
        ends = (a.x, a.y, a.z), (b.x, b.y, b.z)
    verdict = _verdict(state.verdict)
    if (ends is None and verdict is not Verdict.UNKNOWN) or not all(map(math.isfinite, sum(ends or (), ()))):
        raise ProtocolError(f"sight line {state.id} is stated without a verdict, or with ends that are not finite")
    try:
        fidelity, reason = Fidelity(state.fidelity or Fidelity.VERDICT), UnknownReason(state.unknown_reason)
    except ValueError as error:
        raise ProtocolError(f"sight line {state.id}: {error}") from None
    return StatedLine(
        id=state.id,
        ends=ends,
        verdict=verdict,
        fidelity=fidelity,
        unknown_reason=reason,
        obstruction_distance_m=state.obstruction_distance_m,
        first_obstruction=state.first_obstruction if state.HasField("first_obstruction") else None,
    )


_FRAME_NAMES: dict[int, Frame] = {number: name for name, number in _FRAMES.items()}  # type: ignore[misc]


def exercise(name: str, wire: exercise_wire.GetExerciseResponse) -> Exercise:
    """An exercise at its present epoch."""
    agl = common.ALTITUDE_REFERENCE_ABOVE_GROUND
    entities = tuple(
        Entity(
            id=e.id,
            position=(e.position.x, e.position.y, e.position.z),
            frame=_FRAME_NAMES.get(e.frame, "map"),
            altitude="agl" if e.altitude == agl else "absolute",
            ground_m=e.ground_m,
        )
        for e in wire.entities
    )
    leases = tuple(
        LeaseState(e.owner, e.term_s, e.remaining_s, e.streams, e.holds_exercise, e.entities, e.sight_lines)
        for e in wire.leases
    )
    return Exercise(name, wire.epoch, entities, {s.id: stated_line(s) for s in wire.sight_lines}, leases)


def lease(given: Lease | None) -> exercise_wire.Lease | None:
    """A lease, or none."""
    return exercise_wire.Lease(owner=given.owner, term_s=given.term_s) if given else None


def verdict_news(wire: exercise_wire.WatchExerciseResponse) -> VerdictNews:
    """What is new of verdicts."""
    changed = {line.id: _verdict(line.verdict) for line in wire.changed}
    return VerdictNews(wire.epoch, changed, tuple(wire.removed), tuple(wire.expired_owners))
