from __future__ import annotations

import math

import numpy as np
import pytest

from sightline import Pose, Region, Settings


def rotate(q: tuple[float, float, float, float], v: tuple[float, float, float]) -> np.ndarray:
    axis, w = np.array(q[:3]), q[3]
    t = 2 * np.cross(axis, v)
    return np.array(v) + w * t + np.cross(axis, t)


@pytest.mark.parametrize("target", [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1), (3, -4, -5), (-2, 1, 7)])
def test_a_pose_looks_at_its_target_upright(target: tuple[float, float, float]) -> None:
    eye = np.array([100.0, -20.0, 7.0])
    pose = Pose.looking(eye, eye + target)
    ahead, right, up = (rotate(pose.rotation, v) for v in ((0, 0, -1), (1, 0, 0), (0, 1, 0)))
    assert np.allclose(ahead, np.array(target) / math.dist((0, 0, 0), target))
    assert abs(right[2]) < 1e-12 and up[2] >= -1e-12
    assert abs(sum(c * c for c in pose.rotation) - 1) < 1e-12


def test_a_pose_without_direction_is_refused() -> None:
    with pytest.raises(ValueError, match="direction"):
        Pose.looking((1, 2, 3), (1, 2, 3))


def test_targets_of_settings() -> None:
    assert Settings(triangles=7).to_wire().triangle_budget.triangles == 7
    assert Settings(screen_error_px=2.0).to_wire().WhichOneof("target") == "screen_error"
    assert Settings(frame_time_ms=8.0).to_wire().WhichOneof("target") == "frame_time"
    assert Settings(lines=[3, 4]).to_wire().subscription.list.ids == [3, 4]
    assert Settings(lines="none").to_wire().subscription.WhichOneof("lines") == "none"
    assert Settings(half_height_m=300.0).to_wire().orthographic.half_height_m == 300
    assert Settings(regions=[Region(1.0, 2.0, 3.0, 4.0)]).to_wire().regions[0].weight == 4
    with pytest.raises(ValueError, match="two targets"):
        Settings(screen_error_px=1.0, frame_time_ms=1.0).to_wire()
    with pytest.raises(ValueError, match="lines"):
        Settings(lines="some").to_wire()  # type: ignore[arg-type]
