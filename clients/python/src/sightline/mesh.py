"""A mesh that frames keep up to date, and its arrays.

A mesh is a set of active posts with integer heights; its triangles follow by descending from the root square
(`proto/WIRE.md`). :class:`Mesh` is immutable as far as its users see; a frame replaces what it holds, whole or not at all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .diamond import Post, corners, inside, parents
from .errors import PayloadError, ProtocolError
from .payload import decode

Triangle = tuple[Post, Post, Post]
"""The apex, an end of the base, the other end."""

_MASK = (1 << 64) - 1
MAX_EXPONENT = 31
"""Root squares have at most 2**31 cells a side: indices of posts have 32 bits."""


def _mix(n: int) -> int:
    z = (n + 0x9E3779B97F4A7C15) & _MASK
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & _MASK
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & _MASK
    return z ^ (z >> 31)


def post_hash(i: int, j: int, height: int) -> int:
    """What one active post adds to the hash of a mesh, modulo 2**64."""
    return _mix(_mix((j << 32) + i) ^ (height & 0xFFFFFFFF))


@dataclass(frozen=True, slots=True)
class Grid:
    """Size of a terrain: `nx` posts east, `ny` posts north, in a root square of `2**exponent` cells a side."""

    nx: int
    ny: int
    exponent: int

    def __post_init__(self) -> None:
        covered = max(self.nx, self.ny) - 1
        if min(self.nx, self.ny) < 2 or self.exponent > MAX_EXPONENT or (covered - 1).bit_length() != self.exponent:
            raise ProtocolError(f"a grid of {self.nx} x {self.ny} posts with root exponent {self.exponent} is not one")

    @property
    def side(self) -> int:
        """Cells along a side of the root square."""
        return 1 << self.exponent


class Mesh:
    """The mesh of one view, as far as its frames have told it.

    `scale` is (metres per post east, metres per post north, metres per height unit): it leads from the grid frame to the
    scene frame. `corner_heights` are those of the root square, south-west, south-east, north-west, north-east.
    """

    def __init__(self, grid: Grid, corner_heights: Iterable[int], scale: tuple[float, float, float] = (1, 1, 1)) -> None:
        heights = list(corner_heights)
        if len(heights) != 4 or not all(-(1 << 31) <= z < 1 << 31 for z in heights):
            raise ProtocolError(f"a terrain has 4 corner heights of 32 bits; here they are {heights}")
        self.grid = grid
        self.scale = scale
        self._corners = dict(zip(corners(grid.side), heights, strict=True))
        self._posts: dict[Post, int] = dict(self._corners)
        self._triangle_count = 2
        self._hash = self._hash_of(self._posts)
        self._arrays: tuple[npt.NDArray[np.int64], npt.NDArray[np.int32]] | None = None

    @staticmethod
    def _hash_of(posts: dict[Post, int]) -> int:
        return sum(post_hash(i, j, z) for (i, j), z in posts.items()) & _MASK

    @property
    def triangle_count(self) -> int:
        """Triangles of the mesh, those beyond the grid included: what a budget counts."""
        return self._triangle_count

    @property
    def hash(self) -> int:
        """The 64-bit hash of the active posts, which frames announce."""
        return self._hash

    @property
    def posts(self) -> dict[Post, int]:
        """Heights of the active posts, the corners of the root square included, by (i, j); a copy."""
        return dict(self._posts)

    def height(self, p: Post) -> int | None:
        """The height of a post in height units; None if it is not active."""
        return self._posts.get(p)

    def with_posts(self, posts: dict[Post, int]) -> Mesh:
        """A mesh of the same terrain with exactly these posts beside the corners. Each needs its parents."""
        made = Mesh(self.grid, self._corners.values(), self.scale)
        made._posts.update(posts)
        for p in posts:
            if not inside(p, self.grid.side) or any(q not in made._posts for q in parents(p, self.grid.side)):
                raise ValueError(f"post {p} is outside the root square, or lacks a parent")
        made._triangle_count = 2 + sum(len(parents(p, self.grid.side)) for p in made._posts.keys() - self._corners.keys())
        made._hash = self._hash_of(made._posts)
        return made

    def apply(self, payload: bytes, triangle_count: int, mesh_hash: int, max_triangles: int, *, snapshot: bool) -> None:
        """Takes the payload of a frame, or changes nothing and raises :class:`PayloadError`.

        `triangle_count` and `mesh_hash` are what the frame announces, `snapshot` whether it is based on nothing.
        """
        if triangle_count > max_triangles:
            raise PayloadError(f"a frame of {triangle_count} triangles, where at most {max_triangles} were asked for")
        change = decode(payload, self._posts, self.grid.exponent, max_triangles)
        if change.snapshot != snapshot:
            raise PayloadError("a frame and its payload disagree on whether it is a snapshot")
        side = self.grid.side
        base = self._corners if snapshot else self._posts
        count = 2 if snapshot else self._triangle_count
        total = self._hash_of(self._corners) if snapshot else self._hash
        for p, z in change.added.items():
            count += len(parents(p, side))
            total += post_hash(*p, z)
        for p in change.removed:
            count -= len(parents(p, side))
            total -= post_hash(*p, base[p])
        total &= _MASK
        if count != triangle_count:
            raise PayloadError(f"the frame announces {triangle_count} triangles; its mesh has {count}")
        if total != mesh_hash:
            raise PayloadError(f"the frame announces hash {mesh_hash:016x}; its mesh has {total:016x}")
        if snapshot:
            self._posts = dict(self._corners)
        for p in change.removed:
            del self._posts[p]
        self._posts.update(change.added)
        self._triangle_count, self._hash, self._arrays = count, total, None

    def __iter__(self) -> Iterator[Triangle]:
        """The triangles, depth first, those beyond the grid included."""
        return self.walk(lambda _: False)

    def walk(self, skip: Callable[[Triangle], bool]) -> Iterator[Triangle]:
        """The triangles, depth first, without those inside a triangle of any level that `skip` answers with True."""
        s = self.grid.side
        pending: list[Triangle] = [((0, s), (s, s), (0, 0)), ((s, 0), (0, 0), (s, s))]
        while pending:
            triangle = a, e0, e1 = pending.pop()
            if skip(triangle):
                continue
            x, y = e0[0] + e1[0], e0[1] + e1[1]
            m = (x // 2, y // 2)
            if x % 2 == 0 and y % 2 == 0 and m in self._posts:
                pending += [(m, e1, a), (m, a, e0)]
            else:
                yield triangle

    # --- arrays

    def _indexed(self) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int32]]:
        """Posts and heights that drawn triangles use, (n, 3) as i, j, z; and the triangles, (t, 3)."""
        if self._arrays is None:
            posts = np.array(sorted((j << 32) + i for i, j in self._posts), dtype=np.int64)
            triangles = self._descend(posts)
            i, j = posts & 0xFFFFFFFF, posts >> 32
            least_i, least_j = i[triangles].min(axis=1), j[triangles].min(axis=1)
            triangles = triangles[(least_i < self.grid.nx - 1) & (least_j < self.grid.ny - 1)]
            used, numbers = np.unique(triangles, return_inverse=True)
            i, j = i[used], j[used]
            z = np.array([self._posts[p] for p in zip(i.tolist(), j.tolist(), strict=True)], dtype=np.int64)
            self._arrays = np.column_stack([i, j, z]), numbers.reshape(triangles.shape).astype(np.int32)
        return self._arrays

    def _descend(self, posts: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        """All triangles as indices into the sorted keys `posts`, counter-clockwise from above, level by level."""
        s = self.grid.side
        key = np.array([[s, s << 32], [0, (s << 32) + s], [(s << 32) + s, 0]], dtype=np.int64)
        a, e0, e1 = np.searchsorted(posts, key)
        done = []
        while a.size:
            middle = (posts[e0] + posts[e1]) >> 1
            even = ((posts[e0] + posts[e1]) & ((1 << 32) + 1)) == 0
            m = np.minimum(np.searchsorted(posts, middle), posts.size - 1)
            split = even & (posts[m] == middle)
            done.append(np.column_stack([a[~split], e1[~split], e0[~split]]))
            a, e0, e1, m = a[split], e0[split], e1[split], m[split]
            a, e0, e1 = np.concatenate([m, m]), np.concatenate([a, e1]), np.concatenate([e0, a])
        return np.concatenate(done)

    def vertices(self, frame: str = "scene") -> npt.NDArray[np.float64]:
        """Positions of the vertices: (n, 3), float64.

        In the scene frame metres east, north and up of the south-west post; in the ``"grid"`` frame posts east, posts
        north and height units.
        """
        posts = self._indexed()[0].astype(np.float64)
        if frame == "grid":
            return posts
        if frame == "scene":
            return np.multiply(posts, self.scale)
        raise ValueError(f"frame {frame!r} is neither 'scene' nor 'grid'")

    def triangles(self) -> npt.NDArray[np.int32]:
        """Indices into :meth:`vertices`: (t, 3), int32, counter-clockwise seen from above.

        Triangles that share no interior with the grid are left out, those that reach beyond it are whole.
        """
        return self._indexed()[1].copy()
