"""Client of a Sightline server: exact lines of sight, and meshes on which they come out the same.

    import sightline

    with sightline.connect("127.0.0.1:7410") as server:
        print(server.line_of_sight((500, 400, 2), (900, 700, 2), altitude="agl").verdict)

:func:`connect` blocks; :mod:`sightline.aio` has the same calls for `asyncio`. A view's mesh is decoded, checked and asked
for verdicts here, by code that shares nothing with the server but its specification (`proto/WIRE.md`).
"""

from . import aio
from .blocking import Client, View, Watch, connect
from .camera import Pace, Pose, Region, Settings
from .channel import Access
from .errors import (
    ConnectError,
    DeadlineExceeded,
    PayloadError,
    ProtocolError,
    Refused,
    SceneError,
    SightlineError,
)
from .mesh import Grid, Mesh
from .scene import Frame, Scene
from .types import (
    EYE_LINE_ID,
    AtEntity,
    AtPoint,
    Disc,
    Entity,
    Exercise,
    ExerciseSummary,
    Fidelity,
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
    Profile,
    Ray,
    RayEnd,
    Recording,
    SightLine,
    StatedLine,
    Status,
    Stretch,
    Terrain,
    UnknownReason,
    Verdict,
    VerdictNews,
    Viewshed,
)
from .verdict import verdict_on_mesh

__all__ = [
    "EYE_LINE_ID",
    "Access",
    "AtEntity",
    "AtPoint",
    "Client",
    "ConnectError",
    "DeadlineExceeded",
    "Disc",
    "Entity",
    "Exercise",
    "ExerciseSummary",
    "Fidelity",
    "Frame",
    "Grid",
    "GroundState",
    "Heights",
    "Horizon",
    "Lease",
    "LeaseState",
    "LimitUse",
    "LineOfSight",
    "LineState",
    "LinesOfSight",
    "Mesh",
    "Obstruction",
    "Pace",
    "PayloadError",
    "Pose",
    "Profile",
    "ProtocolError",
    "Ray",
    "RayEnd",
    "Recording",
    "Refused",
    "Region",
    "Scene",
    "SceneError",
    "Settings",
    "SightLine",
    "SightlineError",
    "StatedLine",
    "Status",
    "Stretch",
    "Terrain",
    "UnknownReason",
    "Verdict",
    "VerdictNews",
    "View",
    "Viewshed",
    "Watch",
    "aio",
    "connect",
    "verdict_on_mesh",
]
