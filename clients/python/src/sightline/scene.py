"""What a client knows of one view, from the bytes received alone: its mesh, its sight lines, which of them are named.

:class:`Scene` takes the messages of a scene stream in order, so that a recorded stream replays to the same state. It
checks what it is told (`proto/sightline/v1/scene.proto`): hash and count of each frame, that the sight lines of an epoch
come before its first frame, that lines are named as a change against the frame before.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from . import convert
from .errors import ProtocolError, SceneError
from .mesh import Grid, Mesh
from .types import EYE_LINE_ID, StatedLine, Verdict
from .v1 import scene_pb2 as wire
from .verdict import verdict_on_mesh

MAX_LINES = 1 << 20
"""Most sight lines that a client keeps of one view."""


@dataclass(frozen=True, slots=True)
class Frame:
    """What a frame said beside its mesh."""

    sequence: int
    """Counts the frames of the view from 1."""
    base_sequence: int
    """The frame that it changes; 0: a snapshot."""
    pose_sequence: int
    """The pose that it was made for: 0 for the first one."""
    epoch: int
    """The exercise's epoch whose sight lines it honours."""
    triangles: int
    bound_px: float
    """No point of the terrain in the picture is drawn further off than this, in pixels; may be infinite."""
    mesh_hash: int
    payload_bytes: int
    held_back_ms: int
    """How long it was due and held back by the view's pace; 0 when it was not."""


class Scene:
    """One view as its client knows it. Frames of more than `max_triangles` triangles are refused.

    `lines_expected` is False for a view without an exercise: then frames come without updates of sight lines.
    """

    def __init__(self, opened: wire.ViewOpened, max_triangles: int, lines_expected: bool) -> None:
        self.terrain = convert.terrain(opened.terrain)
        grid = Grid(self.terrain.nx, self.terrain.ny, self.terrain.root_exponent)
        scale = self.terrain.scale
        if not all(math.isfinite(s) and s > 0 for s in scale):
            raise ProtocolError(f"metres per post and per height unit are finite and above 0; here they are {scale}")
        self.mesh = Mesh(grid, self.terrain.corner_heights, scale)
        self.max_triangles = max_triangles
        self.lines_expected = lines_expected
        self.epoch = 0
        self.lines: dict[int, StatedLine] = {}
        self.unsatisfied: Mapping[int, int] = {}
        """Lines named as not holding on this mesh, by id, each with the triangles that it asked for in addition to those of
        the lines before it when it was given up; 0: no mesh can help it."""
        self.off_ground: frozenset[int] = frozenset()
        """Entities from whose ground this mesh is further off than their `ground_m`."""
        self.frame: Frame | None = None

    def keep_mesh(self, of: Scene) -> None:
        """Shows the mesh that the same view had before it was opened anew, until the first frame, which is a snapshot."""
        if of.terrain == self.terrain:
            self.mesh = of.mesh

    def apply(self, message: wire.StreamSceneResponse) -> Literal["exercise", "frame"]:
        """Takes the next message of the stream; raises and changes nothing if it does not fit."""
        kind = message.WhichOneof("response")
        if kind == "exercise":
            self._update(message.exercise)
            return "exercise"
        if kind == "frame":
            self._advance(message.frame)
            return "frame"
        raise SceneError("a message that has no place in an open stream")

    def _update(self, update: wire.ExerciseUpdate) -> None:
        if update.epoch < self.epoch:
            raise SceneError(f"an update for epoch {update.epoch} after epoch {self.epoch}")
        if len(self.lines) + len(update.changed) > MAX_LINES:
            raise SceneError(f"more than {MAX_LINES} sight lines")
        changed = [convert.stated_line(state) for state in update.changed]
        for line_id in update.removed:
            self.lines.pop(line_id, None)
        self.lines.update((line.id, line) for line in changed)
        self.epoch = update.epoch

    def _advance(self, frame: wire.Frame) -> None:
        if self.lines_expected and frame.epoch != self.epoch:
            raise SceneError(f"frame {frame.sequence} is of epoch {frame.epoch}, the sight lines held of {self.epoch}")
        snapshot = frame.base_sequence == 0
        held = self.frame.sequence if self.frame else 0
        if not snapshot and frame.base_sequence != held:
            raise SceneError(f"frame {frame.sequence} changes frame {frame.base_sequence}, but frame {held} is held")
        unsatisfied = self._renamed(frame, snapshot)
        payload, count = frame.mesh, frame.triangle_count
        self.mesh.apply(payload, count, frame.mesh_hash, self.max_triangles, snapshot=snapshot)
        self.unsatisfied = unsatisfied
        kept = frozenset() if snapshot else self.off_ground
        self.off_ground = kept.difference(frame.no_longer_off_ground).union(frame.now_off_ground)
        self.frame = Frame(
            sequence=frame.sequence,
            base_sequence=frame.base_sequence,
            pose_sequence=frame.pose_sequence,
            epoch=frame.epoch,
            triangles=count,
            bound_px=frame.distortion_bound_px,
            mesh_hash=frame.mesh_hash,
            payload_bytes=len(payload),
            held_back_ms=frame.held_back_ms,
        )

    def _renamed(self, frame: wire.Frame, snapshot: bool) -> dict[int, int]:
        named = {} if snapshot else dict(self.unsatisfied)
        for line_id in frame.no_longer_unsatisfied:
            if line_id not in named:
                raise SceneError(f"frame {frame.sequence} takes back sight line {line_id}, which was not named")
            del named[line_id]
        for line in frame.now_unsatisfied:
            if line.id != EYE_LINE_ID and line.id not in self.lines:
                raise SceneError(f"frame {frame.sequence} names sight line {line.id}, which is not known")
            named[line.id] = line.lacking_triangles
        return named

    def verdicts(self) -> dict[int, Verdict]:
        """The exact verdict of each sight line with ends on this view's own mesh, by id."""
        return {n: verdict_on_mesh(self.mesh, *line.ends) for n, line in sorted(self.lines.items()) if line.ends}

    def disagreements(self) -> list[int]:
        """Sight lines whose verdict on this mesh is not the server's, although the frame does not name them: none, ever."""
        found = self.verdicts()
        return [
            n
            for n, verdict in found.items()
            if self.lines[n].verdict not in (Verdict.UNKNOWN, verdict) and n not in self.unsatisfied
        ]
