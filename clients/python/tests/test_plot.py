"""Pictures: drawn, and what is on them is what was asked."""

from __future__ import annotations

import numpy as np
import pytest
from support import CELL_M, NX, VOID, Server

import sightline
from sightline import Pose, Settings

pytest.importorskip("matplotlib")
from sightline import plot  # noqa: E402


def test_a_profile(server: sightline.Client) -> None:
    terrain = server.terrain()
    ground = server.profile((0, VOID[1]), (NX - 1, VOID[1]), frame="grid")
    axes = plot.profile(ground, terrain, line_z=(150, 90))
    earth, line = axes.lines
    assert np.nanmax(earth.get_xdata()) == pytest.approx((NX - 1) * CELL_M)
    assert np.isnan(earth.get_ydata()).any(), "the void is a gap"
    assert line.get_ydata()[[0, -1]].tolist() == [150, 90]
    assert np.diff(line.get_ydata(), 2) == pytest.approx(0, abs=1e-9), "a straight line"


def test_a_viewshed(server: sightline.Client) -> None:
    seen = server.viewshed((33, 30, 3), radius_m=300, frame="grid", altitude="agl")
    (image,) = plot.viewshed(seen).images
    assert (np.asarray(image.get_array()) == seen.cells).all()
    west, east, south, north = image.get_extent()
    assert (east - west, north - south) == (21 * CELL_M, 21 * CELL_M)


def test_a_scene(server: sightline.Client, running: Server, tmp_path) -> None:  # type: ignore[no-untyped-def]
    with server.view(Pose.looking((200, 300, 400), (1500, 1000, 0)), Settings(triangles=300)) as view:
        view.frame()
        axes = plot.scene(view.scene)
    axes.figure.savefig(tmp_path / "scene.png", dpi=60)
    assert (tmp_path / "scene.png").stat().st_size > 1000
