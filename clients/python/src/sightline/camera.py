"""Where a viewer is, what it sees, and what its meshes are to aim for."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from .types import Point
from .v1 import common_pb2 as common
from .v1 import scene_pb2 as scene


@dataclass(frozen=True, slots=True)
class Pose:
    """Place and orientation of a camera, scene frame (metres east, north, up of the south-west post)."""

    eye: tuple[float, float, float]
    rotation: tuple[float, float, float, float]
    """Unit quaternion x, y, z, w from the camera frame (x right, y up, looking along -z) to the scene frame."""

    @classmethod
    def looking(cls, eye: Point, target: Point) -> Pose:
        """At `eye`, looking at `target`, upright; both in the scene frame. Straight up or down, north is up."""
        at = np.asarray(eye, dtype=np.float64)
        ahead = np.asarray(target, dtype=np.float64) - at
        distance = float(np.linalg.norm(ahead))
        if at.shape != (3,) or not math.isfinite(distance) or distance == 0:
            raise ValueError(f"no direction leads from eye {eye!r} to target {target!r}")
        ahead = ahead / distance
        right = np.cross(ahead, (0.0, 0.0, 1.0))
        if float(np.linalg.norm(right)) < 1e-9:
            right = np.array([1.0, 0.0, 0.0])
        right = right / np.linalg.norm(right)
        axes = np.column_stack([right, np.cross(right, ahead), -ahead])
        x, y, z = at.tolist()
        return cls((x, y, z), _quaternion(axes.tolist()))

    def to_wire(self) -> scene.Pose:
        """The message."""
        (ex, ey, ez), (x, y, z, w) = self.eye, self.rotation
        return scene.Pose(eye=common.Position(x=ex, y=ey, z=ez), rotation=scene.Quaternion(x=x, y=y, z=z, w=w))


def _quaternion(m: list[list[float]]) -> tuple[float, float, float, float]:
    """The unit quaternion of a rotation matrix, from the greatest of its four parts, so that nothing is divided by 0."""
    trace = m[0][0] + m[1][1] + m[2][2]
    if trace > 0:
        q = [m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1], 1 + trace]
    else:
        i = max(range(3), key=lambda k: m[k][k])
        j, k = (i + 1) % 3, (i + 2) % 3
        q = [0.0] * 4
        q[i] = 1 + m[i][i] - m[j][j] - m[k][k]
        q[j], q[k], q[3] = m[j][i] + m[i][j], m[k][i] + m[i][k], m[k][j] - m[j][k]
    size = math.sqrt(sum(c * c for c in q))
    return q[0] / size, q[1] / size, q[2] / size, q[3] / size


@dataclass(frozen=True, slots=True)
class Region:
    """A disc in plan, scene frame, in which distortion counts `weight` times, at least once."""

    east_m: float
    north_m: float
    radius_m: float
    weight: float


@dataclass(frozen=True, slots=True)
class Pace:
    """How fast a view sends. Between two frames the newest state waits; nothing queues, and no frame is thinned out."""

    max_rate_hz: float = 0.0
    """Greatest number of frames in a second, up to 1,000; 0: one on every change."""
    max_bytes_per_s: int = 0
    """Greatest number of bytes of messages in a second in the long run, from 1,000 on; 0: no limit."""

    def to_wire(self) -> scene.Pace:
        """The message."""
        return scene.Pace(max_rate_hz=self.max_rate_hz, max_bytes_per_s=self.max_bytes_per_s)


@dataclass(frozen=True, slots=True)
class Settings:
    """Camera, target, subscription and regions of a view.

    The target is `triangles` alone (the best mesh of at most so many), or with `screen_error_px` (the smallest mesh that
    good), or with `frame_time_ms` (as many as the client draws in that time); `triangles` caps those two.
    """

    triangles: int = 10_000
    screen_error_px: float | None = None
    frame_time_ms: float | None = None
    fov_deg: float = 60.0
    """Vertical field of view of a perspective."""
    half_height_m: float | None = None
    """Half the height of the picture in a parallel projection; None for a perspective."""
    near_m: float = 1.0
    viewport_px: tuple[int, int] = (1280, 720)
    lines: Literal["all", "none"] | Sequence[int] = field(default="all")
    """The sight lines that each frame must honour: all, none, or those with these ids."""
    regions: Sequence[Region] = ()
    """Where the mesh is to be finer than the picture alone asks for."""

    def to_wire(self) -> scene.ViewSettings:
        """The message."""
        width, height = self.viewport_px
        wire = scene.ViewSettings(viewport_width_px=width, viewport_height_px=height)
        if self.half_height_m is None:
            wire.perspective.tan_half_fov = math.tan(math.radians(self.fov_deg) / 2)
            wire.perspective.near_m = self.near_m
        else:
            wire.orthographic.half_height_m, wire.orthographic.near_m = self.half_height_m, self.near_m
        for r in self.regions:
            wire.regions.add(east_m=r.east_m, north_m=r.north_m, radius_m=r.radius_m, weight=r.weight)
        if self.screen_error_px is not None and self.frame_time_ms is not None:
            raise ValueError("screen_error_px and frame_time_ms are two targets: give one")
        if self.screen_error_px is not None:
            wire.screen_error.pixels, wire.screen_error.max_triangles = self.screen_error_px, self.triangles
        elif self.frame_time_ms is not None:
            wire.frame_time.milliseconds, wire.frame_time.max_triangles = self.frame_time_ms, self.triangles
        else:
            wire.triangle_budget.triangles = self.triangles
        if isinstance(self.lines, str):
            if self.lines not in ("all", "none"):
                raise ValueError(f"lines={self.lines!r} is neither 'all', 'none' nor a sequence of ids")
            chosen = wire.subscription.all if self.lines == "all" else wire.subscription.none
            chosen.SetInParent()
        else:
            wire.subscription.list.ids.extend(self.lines)
            wire.subscription.list.SetInParent()
        return wire
