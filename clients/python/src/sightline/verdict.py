"""The verdict of a sight line on a mesh, exactly.

BLOCKED when some point of the closed segment AB over the grid rectangle [0, nx - 1] x [0, ny - 1] lies strictly below the
mesh, else VISIBLE; contact does not block.

All arithmetic is on integers and :class:`fractions.Fraction`: a finite float is a whole number of some 2**-k, so both ends
times 2**k are integers, and with them every linear function below. On a right-angled triangle with apex a and legs
u = e0 - a, v = e1 - a of equal length, a point p has the coordinates (p - a).u and (p - a).v, both times 1 / (u.u). These,
1 less their sum, and the height of the line over the triangle's plane are linear in the place t along AB. The triangle cuts
a closed interval of t out of [0, 1]; there the height over the plane is linear, so its ends decide.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction

from .diamond import Post
from .mesh import Mesh, Triangle
from .types import Verdict

_ZERO, _ONE = Fraction(0), Fraction(1)
Interval = tuple[Fraction, Fraction]


class _Line:
    """AB in units of 2**-shift, as integers."""

    def __init__(self, a: Sequence[float], b: Sequence[float]) -> None:
        numbers = [float(c) for c in (*a, *b)]
        if len(a) != 3 or len(b) != 3 or not all(map(math.isfinite, numbers)):
            raise ValueError(f"the ends of a line are three finite numbers each; here they are {a!r} and {b!r}")
        ratios = [c.as_integer_ratio() for c in numbers]
        self.unit = max(den for _, den in ratios)
        whole = [num * (self.unit // den) for num, den in ratios]
        (self.ax, self.ay, self.az), (self.bx, self.by, self.bz) = whole[:3], whole[3:]

    def apart(self, corners: Sequence[Post]) -> bool:
        """Whether all corners lie strictly to one side of the line in plan: a cheap proof that it misses them."""
        dx, dy, unit = self.bx - self.ax, self.by - self.ay, self.unit
        sides = [dx * (j * unit - self.ay) - dy * (i * unit - self.ax) for i, j in corners]
        return min(sides) > 0 or max(sides) < 0


def _clip(interval: Interval, at_a: int, at_b: int) -> Interval | None:
    """The part of an interval of t on which the linear function with these values at A and B is not negative."""
    low, high = interval
    if at_a < 0:
        if at_b < 0:
            return None
        low = max(low, Fraction(-at_a, at_b - at_a))
    elif at_b < 0:
        high = min(high, Fraction(at_a, at_a - at_b))
    return (low, high) if low <= high else None


def _over_grid(line: _Line, mesh: Mesh) -> Interval | None:
    interval: Interval | None = (_ZERO, _ONE)
    east, north = (mesh.grid.nx - 1) * line.unit, (mesh.grid.ny - 1) * line.unit
    bounds = [(line.ax, line.bx), (line.ay, line.by), (east - line.ax, east - line.bx), (north - line.ay, north - line.by)]
    for at_a, at_b in bounds:
        interval = interval and _clip(interval, at_a, at_b)
    return interval


def _dips(line: _Line, mesh: Mesh, triangle: Triangle, interval: Interval) -> bool:
    """Whether the line is strictly below the triangle somewhere in `interval` of t."""
    (ai, aj), (i0, j0), (i1, j1) = triangle
    za, z0, z1 = (mesh.height(p) for p in triangle)
    if za is None or z0 is None or z1 is None:
        raise ValueError(f"triangle {triangle} has a corner without a height")
    ui, uj, vi, vj = i0 - ai, j0 - aj, i1 - ai, j1 - aj
    square = ui * ui + uj * uj
    unit = line.unit

    def functions(x: int, y: int, z: int) -> tuple[int, int, int, int]:
        px, py = x - ai * unit, y - aj * unit
        along_u, along_v = px * ui + py * uj, px * vi + py * vj
        above = square * (z - za * unit) - along_u * (z0 - za) - along_v * (z1 - za)
        return above, along_u, along_v, square * unit - along_u - along_v

    above_a, *inside_a = functions(line.ax, line.ay, line.az)
    above_b, *inside_b = functions(line.bx, line.by, line.bz)
    if above_a >= 0 and above_b >= 0:
        return False
    cut: Interval | None = interval
    for at_a, at_b in zip(inside_a, inside_b, strict=True):
        cut = cut and _clip(cut, at_a, at_b)
    return cut is not None and any(above_a + t * (above_b - above_a) < 0 for t in cut)


def verdict_on_mesh(mesh: Mesh, a: Sequence[float], b: Sequence[float]) -> Verdict:
    """The exact verdict of AB on `mesh`, VISIBLE or BLOCKED; ends in the grid frame (posts, posts, height units)."""
    line = _Line(a, b)
    interval = _over_grid(line, mesh)
    if interval is None:
        return Verdict.VISIBLE
    blocked = any(_dips(line, mesh, triangle, interval) for triangle in mesh.walk(line.apart))
    return Verdict.BLOCKED if blocked else Verdict.VISIBLE
