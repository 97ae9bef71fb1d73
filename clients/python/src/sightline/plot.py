"""Pictures for notebooks, by way of matplotlib (``pip install sightline[plot]``).

Each function draws on the axes given, or on new ones, and returns them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .scene import Scene
from .types import EYE_LINE_ID, Profile, Terrain, Verdict, Viewshed

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = {Verdict.VISIBLE: "#2b8a3e", Verdict.UNKNOWN: "#868e96", Verdict.BLOCKED: "#c92a2a"}


def _axes(axes: Axes | None, **subplot: Any) -> Any:
    if axes is not None:
        return axes
    try:
        import matplotlib.pyplot as plt
    except ImportError as error:
        raise ImportError("pictures need matplotlib: pip install sightline[plot]") from error
    return plt.figure(figsize=(9, 5), layout="constrained").add_subplot(**subplot)


def profile(
    ground: Profile, terrain: Terrain, *, line_z: tuple[float, float] | None = None, axes: Axes | None = None
) -> Axes:
    """The ground under a line: distance in metres to the right, height in metres upward; gaps where it is unknown.

    `line_z`, the heights of a line's ends in height units, draws the line too, lowered as the profile says.
    """
    ax: Axes = _axes(axes)
    east, north, up = terrain.scale
    x, y = (ground.x - ground.x[:1]) * east, (ground.y - ground.y[:1]) * north
    distance = np.hypot(x, y)
    # A stretch of unknown ground between two known breaks is a gap, too.
    gaps = np.flatnonzero(~ground.known_after[:-1]) + 1
    along, earth = np.insert(distance, gaps, np.nan), np.insert(ground.ground * up, gaps, np.nan)
    ax.plot(along, earth, color="#5c4033", lw=1)
    if line_z is not None and ground.t.size > 1:
        line = line_z[0] + (line_z[1] - line_z[0]) * ground.t - ground.bulge
        ax.plot(distance, line * up, color="#1971c2", lw=1.2)
    if along.size:
        bottom = ax.get_ylim()[0]
        ax.fill_between(along, earth, bottom, color="#e8dfd5", lw=0)
        ax.set_ylim(bottom=bottom)
        ax.margins(x=0)
    ax.set_xlabel("distance (m)")
    ax.set_ylabel("height (m)")
    return ax


def viewshed(seen: Viewshed, *, axes: Axes | None = None) -> Axes:
    """What an observer sees, in map coordinates: green visible, grey unknown, red blocked."""
    ax: Axes = _axes(axes)
    from matplotlib.colors import BoundaryNorm, ListedColormap
    from matplotlib.patches import Patch

    rows, columns = seen.cells.shape
    west, south = seen.terrain.map_from_grid(seen.first_i - 0.5, seen.first_j - 0.5)
    east, north = seen.terrain.map_from_grid(seen.first_i + columns - 0.5, seen.first_j + rows - 0.5)
    colours = ListedColormap(["#ffffff00", *(COLOURS[v] for v in Verdict)])
    ax.imshow(
        seen.cells,
        origin="lower",
        extent=(west, east, south, north),
        cmap=colours,
        norm=BoundaryNorm([-0.5, 0.5, 1.5, 2.5, 3.5], 4),
        interpolation="nearest",
    )
    names = [Patch(color=COLOURS[verdict], label=verdict.name.lower()) for verdict, n in seen.counts().items() if n]
    ax.legend(handles=names, loc="upper right", framealpha=0.9)
    terrain = seen.terrain
    ax.set_aspect(terrain.scale[1] / terrain.step[1] * terrain.step[0] / terrain.scale[0])
    ax.set_xlabel("longitude (degrees)" if terrain.geographic else "east (map units)")
    ax.set_ylabel("latitude (degrees)" if terrain.geographic else "north (map units)")
    return ax


def scene(view: Scene, *, axes: Axes | None = None) -> Axes:
    """The mesh of a view from above, by height, and its sight lines in the colours of their verdicts on this mesh.

    A line that the frame names as unsatisfied is dashed.
    """
    ax: Axes = _axes(axes)
    import matplotlib
    from matplotlib.colors import ListedColormap

    vertices, triangles = view.mesh.vertices(), view.mesh.triangles()
    x, y, z = vertices.T
    land = ListedColormap(matplotlib.colormaps["terrain"](np.linspace(0.25, 1, 256)))  # what is below that is the sea
    ax.tripcolor(x, y, z, triangles=triangles, cmap=land, shading="gouraud")
    ax.triplot(x, y, triangles, color="#00000055", lw=0.3)
    for n, verdict in view.verdicts().items():
        ends = view.lines[n].ends
        if n != EYE_LINE_ID and ends:
            a, b = (view.terrain.scene_from_grid(end) for end in ends)
            style = "--" if n in view.unsatisfied else "-"
            ax.plot([a[0], b[0]], [a[1], b[1]], style, color=COLOURS[verdict], lw=1.2)
    ax.set_aspect("equal")
    # Triangles may reach beyond the last posts, where there is no terrain.
    east, north, _ = view.terrain.scene_from_grid((view.terrain.nx - 1, view.terrain.ny - 1, 0))
    ax.set_xlim(0, east)
    ax.set_ylim(0, north)
    ax.set_xlabel("east (m)")
    ax.set_ylabel("north (m)")
    return ax
