"""What questions are made of and what answers hold: enums, dataclasses and numpy arrays.

Frames: *grid* is posts east, posts north and height units from the south-west post; *scene* is metres east, north and up
from the same post; *map* is the DEM's own reference system with z in metres; *geographic* is longitude, latitude (degrees)
and metres.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Verdicts = npt.NDArray[np.int8]
Point = Sequence[float] | Floats
"""Three numbers: x, y, z."""

Frame = Literal["map", "grid", "geographic", "scene"]
Altitude = Literal["absolute", "agl"]
"""What z means: above the DEM's vertical datum, or above the ground."""
Precision = Literal["exact", "f64", "fast"]

State = TypeVar("State", bound="LineState | GroundState")

EYE_LINE_ID = (1 << 64) - 1
"""The id that a frame gives to the requirement that the viewer's eye is not under its own mesh."""


class Verdict(enum.IntEnum):
    """The answer to a line-of-sight question; the numbers are those of the wire and of arrays."""

    VISIBLE = 1
    UNKNOWN = 2
    BLOCKED = 3


class UnknownReason(enum.IntEnum):
    """Why a verdict is UNKNOWN."""

    NOT_UNKNOWN = 0
    UNKNOWN_GROUND = 1
    NO_GROUND = 2
    INACTIVE = 3


class Fidelity(enum.IntEnum):
    """What a sight line asks of each mesh."""

    VERDICT = 1
    WEDGIE = 2
    PROFILE = 3
    OBSTRUCTION = 4


class LineState(enum.IntEnum):
    """How a stretch of a line stands to the ground: above it or on it, strictly below it, over unknown ground."""

    ABOVE = 1
    BELOW = 2
    UNKNOWN = 3


class GroundState(enum.IntEnum):
    """Whether a stretch of ground is seen from A."""

    SEEN = 1
    HIDDEN = 2
    UNKNOWN = 3


class RayEnd(enum.IntEnum):
    """How a ray ends."""

    HIT = 1
    MISS = 2
    STARTS_BELOW = 3
    NO_GROUND = 4


@dataclass(frozen=True, slots=True)
class Terrain:
    """The terrain of a server."""

    version: str
    """Content hash, in hex: servers with the same version hold the same terrain, bit for bit."""
    nx: int
    """Posts from west to east."""
    ny: int
    """Posts from south to north."""
    root_exponent: int
    """The root square has 2**root_exponent cells a side."""
    scale: tuple[float, float, float]
    """Metres per post east, per post north, per height unit, at the grid's centre."""
    heights: tuple[float, float]
    """Lowest and highest known height, in height units."""
    void_posts: int
    origin: tuple[float, float]
    """Map coordinates of post (0, 0)."""
    step: tuple[float, float]
    """Map units per post east and north."""
    epsg: int | None
    geographic: bool
    """Whether map coordinates are longitude and latitude in degrees."""
    corner_heights: tuple[int, ...]
    """Of the root square: south-west, south-east, north-west, north-east, in height units."""

    def map_from_grid(self, x: float, y: float) -> tuple[float, float]:
        """Map coordinates of a plan position in posts."""
        return self.origin[0] + self.step[0] * x, self.origin[1] + self.step[1] * y

    def scene_from_grid(self, point: Point) -> Floats:
        """Metres east, north, up of a position in the grid frame."""
        return np.multiply(point, self.scale, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Heights:
    """Ground heights at plan positions, in the order asked."""

    z: Floats
    """(n,), in the z unit of the frame asked in; NaN where the ground is unknown."""
    normals: Floats | None
    """(n, 3), upward unit normals in the scene frame, if asked for; 0 where no triangle is known."""

    @property
    def known(self) -> Bools:
        """(n,), whether the ground is known."""
        return np.logical_not(np.isnan(self.z))


@dataclass(frozen=True, slots=True)
class Obstruction:
    """Where a line first goes below ground, seen from one of its ends."""

    position: Floats
    """(3,), grid frame."""
    range_m: float
    """Slant range from that end, scene frame."""


@dataclass(frozen=True, slots=True)
class Stretch(Generic[State]):
    """A greatest part of a line, or of the ground under it, in one state."""

    start: float
    """As a part of the line: 0 at A, 1 at B."""
    end: float
    state: State


@dataclass(frozen=True, slots=True)
class LineOfSight:
    """The exact answer to one question."""

    verdict: Verdict
    unknown_reason: UnknownReason
    ends: Floats | None
    """(2, 3), the ends as resolved, grid frame: the verdict is exact for these. None without ground below an end."""
    grazes: bool
    """Whether a visible line touches the ground between its ends."""
    certain: bool
    """Whether verdict and grazing are exact."""
    range_m: float
    """Plan length, scene frame."""
    sagitta_m: float
    """How far the Earth bulges above the chord at mid-line; 0 without a georeference. The verdict ignores it."""
    first_from_a: Obstruction | None = None
    first_from_b: Obstruction | None = None
    least_clearance: float | None = None
    """Of a visible line, height units, if derived values were asked for."""
    deepest: float | None = None
    """Of a blocked line: its greatest depth below ground, height units."""
    least_target_z: float | None = None
    """The least z of the target, grid frame, at which the line would not be blocked."""
    line: tuple[Stretch[LineState], ...] = ()
    """The line by its stretches, if asked for."""
    ground: tuple[Stretch[GroundState], ...] = ()
    """The ground under it by its stretches, if asked for."""

    @property
    def visible(self) -> bool:
        """Whether the verdict is VISIBLE."""
        return self.verdict is Verdict.VISIBLE


@dataclass(frozen=True, slots=True)
class LinesOfSight:
    """The answers to a batch of questions, in its order."""

    verdicts: Verdicts
    """(n,), int8, numbers of :class:`Verdict`."""
    grazes: Bools
    certain: Bools

    @property
    def visible(self) -> Bools:
        """(n,), whether each verdict is VISIBLE."""
        return np.equal(self.verdicts, Verdict.VISIBLE)


@dataclass(frozen=True, slots=True)
class Ray:
    """What a ray meets."""

    end: RayEnd
    segment: Floats | None
    """(2, 3), grid frame: the answer is exact for it."""
    hit: Floats | None
    """(3,), grid frame."""
    range_m: float | None
    """Slant range to the hit, scene frame."""
    normal: Floats | None
    """(3,), upward unit normal of the ground at the hit, scene frame."""
    over_unknown: bool
    """Whether it passes unknown ground before it ends, so that it may have ended there."""


@dataclass(frozen=True, slots=True)
class Horizon:
    """The crest of the ground around an observer, azimuth by azimuth."""

    azimuths_deg: Floats
    """(n,), clockwise from grid north."""
    elevation_deg: Floats
    """(n,), above the horizontal; NaN where no ground is known."""
    range_m: Floats
    """(n,), plan distance of the crest, scene frame; NaN where no ground is known."""
    over_unknown: Bools
    """(n,), whether some ground along the azimuth is unknown, so that the horizon may be higher."""
    below_ground: bool
    """Whether the observer is strictly below ground and sees nothing."""


@dataclass(frozen=True, slots=True)
class Profile:
    """The breaks of the ground under a line, in order; between two the ground is linear, or unknown."""

    t: Floats
    """(n,), place on the line: 0 at its beginning, 1 at its end."""
    x: Floats
    """(n,), posts east."""
    y: Floats
    """(n,), posts north."""
    ground: Floats
    """(n,), height units; NaN where unknown."""
    known_after: Bools
    """(n,), whether all ground up to the next break is known; False for the last."""
    bulge: Floats
    """(n,), height units by which a curved Earth lowers the line there; zeros on a flat one."""


@dataclass(frozen=True, slots=True)
class Viewshed:
    """What an observer sees of the posts of a region."""

    cells: Verdicts
    """(rows, columns), int8: 0 outside the region, else the number of a :class:`Verdict`. Row 0 is the southernmost."""
    first_i: int
    """Column of the post of `cells[:, 0]`."""
    first_j: int
    """Row of the post of `cells[0]`."""
    terrain: Terrain

    @property
    def visible(self) -> Bools:
        """(rows, columns), whether each post is seen."""
        return np.equal(self.cells, Verdict.VISIBLE)

    def counts(self) -> dict[Verdict, int]:
        """How many posts of the region have each verdict."""
        return {verdict: int((self.cells == verdict).sum()) for verdict in Verdict}

    def to_geotiff(self, path: str) -> None:
        """Writes the cells as a GeoTIFF, north up, 0 as no data. Needs rasterio: ``pip install sightline[raster]``."""
        from .raster import write_geotiff

        write_geotiff(self, path)


@dataclass(frozen=True, slots=True)
class Entity:
    """A thing that has a place and may move."""

    id: int
    position: Point
    frame: Frame = "map"
    altitude: Altitude = "absolute"
    ground_m: float = 0.0
    """Above 0: each mesh must be within so many metres of the ground at its place, or name the entity as off the ground."""


@dataclass(frozen=True, slots=True)
class AtEntity:
    """An end of a sight line that follows an entity, `height_offset_m` above it."""

    entity_id: int
    height_offset_m: float = 0.0


@dataclass(frozen=True, slots=True)
class AtPoint:
    """An end of a sight line that stays where it is."""

    position: Point
    frame: Frame = "map"
    altitude: Altitude = "absolute"


@dataclass(frozen=True, slots=True)
class Disc:
    """A disc in plan."""

    centre: Point
    """Its middle: x and y."""
    radius_m: float
    """In the scene frame."""
    frame: Frame = "map"


@dataclass(frozen=True, slots=True)
class SightLine:
    """A sight line to register. Lines are satisfied in order of `priority`, least first, then `id`."""

    id: int
    a: AtEntity | AtPoint
    b: AtEntity | AtPoint
    fidelity: Fidelity = Fidelity.VERDICT
    priority: int = 0
    obstruction_distance_m: float = 0.0
    """Of fidelity OBSTRUCTION: how far off the first obstruction may be."""
    range_m: float = 0.0
    """A longer line is inactive: UNKNOWN, and asking nothing of any mesh. 0: no limit."""
    region: Disc | None = None
    """A line with an end outside it is inactive, too; None: everywhere."""


@dataclass(frozen=True, slots=True)
class StatedLine:
    """A registered sight line as the server states it at one epoch."""

    id: int
    ends: tuple[tuple[float, float, float], tuple[float, float, float]] | None
    """Grid frame; None when an end has no ground below it."""
    verdict: Verdict
    fidelity: Fidelity
    unknown_reason: UnknownReason = UnknownReason.NOT_UNKNOWN
    obstruction_distance_m: float = 0.0
    """Of fidelity OBSTRUCTION: how far off the first obstruction may be."""
    first_obstruction: float | None = None
    """Of fidelity OBSTRUCTION and a blocked line: where it is first obstructed, as a part of it (0 at A), rounded."""


@dataclass(frozen=True, slots=True)
class Lease:
    """For how long something stays in an exercise although nothing is heard of its owner."""

    owner: str
    """A name of the client's choice: 1 to 64 letters, digits, '-', '_' or '.'."""
    term_s: int
    """Its term in seconds, from 1 to 604,800."""


@dataclass(frozen=True, slots=True)
class LeaseState:
    """A lease as it stands, and what is under it."""

    owner: str
    term_s: int
    remaining_s: float
    """Seconds until it runs out; its full term while streams hold it."""
    streams: int
    """Open views and watches that hold it."""
    holds_exercise: bool
    """Whether the exercise itself is under it."""
    entities: int
    sight_lines: int


@dataclass(frozen=True, slots=True)
class VerdictNews:
    """What is new of an exercise's verdicts at an epoch."""

    epoch: int
    changed: dict[int, Verdict]
    """Of sight lines that are new, or whose verdict or its reason is another, by id."""
    removed: tuple[int, ...]
    """Sight lines that are gone."""
    expired_owners: tuple[str, ...]
    """Owners whose leases ran out."""


@dataclass(frozen=True, slots=True)
class Exercise:
    """One running simulation at one epoch."""

    name: str
    epoch: int
    entities: tuple[Entity, ...]
    lines: dict[int, StatedLine]
    """By id."""
    leases: tuple[LeaseState, ...] = ()
    """In the order in which they were given."""


@dataclass(frozen=True, slots=True)
class LimitUse:
    """A limit of a server, and how much of it is in use."""

    used: int
    limit: int


@dataclass(frozen=True, slots=True)
class Recording:
    """What a server records of itself."""

    bytes: int
    limit_bytes: int
    """At which it ends; the server goes on."""
    ended: str
    """Why it has ended; empty while it goes on."""


@dataclass(frozen=True, slots=True)
class Status:
    """How a server is, now and since it started."""

    version: str
    """Of the program."""
    uptime_s: float
    serving: bool
    """Whether its health service says SERVING."""
    troubles: tuple[str, ...]
    """Why it does not, one sentence each."""
    limits: dict[str, LimitUse]
    """By their names in the configuration."""
    connections: int
    exercises: int
    calls: int
    """Since the start; a stream is one."""
    refused_calls: int
    frames: int
    """Sent."""
    frame_median_ms: float
    """Median time to make a frame, by classes a third of a decade wide; 0 before the first."""
    frame_p99_ms: float
    queue_age_ms: float
    """How long the oldest work has waited for a core."""
    visible: int
    """Lines answered VISIBLE; `blocked` and `unknown` likewise."""
    blocked: int
    unknown: int
    exact_signs: int
    """Signs of predicates that only exact arithmetic could tell."""
    unsatisfied_lines: int
    """Over all views, on the last frame of each."""
    received_bytes: int
    sent_bytes: int
    recording: Recording | None
    """Absent when the server was told to make none."""


@dataclass(frozen=True, slots=True)
class ExerciseSummary:
    """The outline of an exercise."""

    name: str
    epoch: int
    entities: int
    sight_lines: int
