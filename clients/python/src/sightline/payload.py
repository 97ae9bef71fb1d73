"""The decoder of mesh payloads: `Frame.mesh`, as `proto/WIRE.md` specifies it, version 2.

Written from that text alone. :func:`decode` gives the posts that a payload adds to its base and those that it removes;
it never changes the base. Bytes that are no payload raise :class:`~sightline.errors.PayloadError`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from .diamond import Post, children, level, parents
from .errors import PayloadError

VERSION = 2
DELTA_BIT = 1 << 6

Corners = tuple[Post, Post, "Post | None", Post]
"""An apex, an end of the base, the other apex (missing on the border), the other end."""


@dataclass(slots=True)
class Context:
    """The probability of a 1, in units of 2**-16, and how many bits it was learnt from."""

    one: int
    seen: int

    def learn(self, bit: bool) -> None:
        pace = (1 << 17) // (2 * self.seen + 3)
        self.one += ((1 << 16) - self.one) * pace >> 16 if bit else -(self.one * pace >> 16)
        self.one = min(max(self.one, 32), (1 << 16) - 32)
        self.seen = min(self.seen + 1, 60)


def _contexts(seen: int, *starts: int) -> list[Context]:
    return [Context(256 * start, seen) for start in starts]


_TOUCHED = (
    (112, 112, 160, 160, 6),
    (3, 3, 3, 3, 3),
    (50, 42, 68, 68, 3),
    (50, 72, 104, 104, 4),
    (108, 120, 160, 160, 6),
    (98, 125, 160, 160, 6),
    (65, 71, 127, 127, 6),
    (66, 87, 130, 130, 9),
    (210, 240, 250, 250, 12),
    (145, 152, 212, 212, 62),
    (147, 119, 170, 170, 62),
    (104, 132, 180, 180, 61),
    (95, 120, 161, 161, 25),
    (70, 81, 127, 127, 12),
)


class _Model:
    """All contexts of one payload, as they are at its start."""

    def __init__(self) -> None:
        self.active = _contexts(2, *[128] * 64)
        self.added = _contexts(8, 17, 17, 17, 74, 49)
        self.removed = _contexts(8, 255, 205, 1, 1, 1)
        self.touched = [_contexts(8, *row) for row in _TOUCHED]
        self.is_long = Context(256 * 112, 4)
        self.longer = _contexts(4, 76, *[56] * 7)
        self.shorter = _contexts(4, 128, 106, 90, 80, 80, 80, 80, 80)
        self.negative = _contexts(4, 128, 128, 144, 112, 160, 96)
        self.second = _contexts(2, *[112] * 16)


class _Bits:
    """The bits of a payload: an arithmetic decoder over the bytes after the first."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.range = (1 << 32) - 1
        self.above = self._word(0)
        self.steps = 0
        if self.above == (1 << 32) - 1:
            raise PayloadError("the payload begins beyond the range of its coder")

    def _word(self, at: int) -> int:
        return int.from_bytes(self.data[at : at + 4].ljust(4, b"\0"), "big")

    def bit(self, context: Context) -> bool:
        part = (self.range >> 16) * context.one
        one = self.above < part
        if one:
            self.range = part
        else:
            self.above -= part
            self.range -= part
        context.learn(one)
        self._refill()
        return one

    def raw(self, digits: int) -> int:
        number = 0
        while digits > 0:
            width = min(digits, 8)
            self.range >>= width
            piece, self.above = divmod(self.above, self.range)
            if piece >> width:
                raise PayloadError("raw digits beyond their width")
            number = number << width | piece
            digits -= width
            self._refill()
        return number

    def _refill(self) -> None:
        while self.range < 1 << 24:
            self.range <<= 8
            following = self.steps + 4
            self.above = self.above << 8 | (self.data[following] if following < len(self.data) else 0)
            self.steps += 1
            if self.steps > len(self.data):
                raise PayloadError("the payload is cut short")

    def end(self) -> None:
        """Checks that the payload ends here, in the one way in which an encoder ends it."""
        word = self._word(self.steps)
        low = (word - self.above) % (1 << 32)
        for k in range(5):
            unit = 1 << (32 - 8 * k)
            v = -(-low // unit) * unit
            if v < low + self.range:
                if len(self.data) != self.steps + k or word != v % (1 << 32):
                    raise PayloadError("the payload does not end where its mesh does")
                return
        raise PayloadError("the payload has no end")  # k = 4 always fits: the range is at least 2**24


@dataclass(slots=True)
class Change:
    """What a payload does to its base."""

    snapshot: bool
    added: dict[Post, int] = field(default_factory=dict)
    removed: set[Post] = field(default_factory=set)


@dataclass(slots=True)
class _Place:
    """A diamond that may be active, and where it stands in the visit that asks for it."""

    post: Post
    corners: Corners
    neighbours: tuple[Post, ...]  # the visited post and those of its children that are the diamond's apexes
    lengths_of: tuple[tuple[Post, Post, Post], ...]  # each neighbour with the ends of its base
    count: int = 1  # n: active children of the visited post
    path: int = 1
    turn: int = 0


class _Walk:
    def __init__(self, payload: bytes, base: Mapping[Post, int], exponent: int, max_triangles: int) -> None:
        self.side, self.exponent = 1 << exponent, exponent
        self.bits = _Bits(payload[1:])
        self.model = _Model()
        self.change = Change(snapshot=not payload[0] & DELTA_BIT)
        corner = (0, self.side)
        self.corner_heights = {(i, j): base[i, j] for j in corner for i in corner}
        self.base = self.corner_heights if self.change.snapshot else base
        self.mean = 1024
        self.room = max_triangles
        self.opened: list[list[tuple[Post, Corners]]] = [[] for _ in range(2 * exponent)]

    # --- what is known of posts

    def held(self, p: Post) -> bool:
        return p in self.base

    def is_new(self, p: Post) -> bool:
        return p not in self.base

    def is_active(self, p: Post) -> bool:
        return p in self.change.added or (p in self.base and p not in self.change.removed)

    def height(self, p: Post) -> int:
        added = self.change.added.get(p)
        return self.base[p] if added is None else added

    # --- the walk

    def run(self) -> Change:
        if self.exponent > 0:
            self.begin()
            childless = 2 * self.exponent - 2
            for posts in self.opened[:childless]:
                for post, around in posts:
                    self.visit(post, around)
            for posts in self.opened[childless:]:
                if any(not self.is_new(post) for post, _ in posts):
                    raise PayloadError("a change is told below a post on which nothing hangs")
        self.bits.end()
        return self.change

    def begin(self) -> None:
        """The centre, and the four posts on the middles of the border."""
        s = self.side
        centre = (s // 2, s // 2)
        around: Corners = (s, 0), (0, 0), (0, s), (s, s)
        self.code(_Place(centre, around, (), ()))
        if not self.is_active(centre):
            return
        ring = [(s, 0), (0, 0), (0, s), (s, s)]
        for k in range(4):
            start, end = ring[k], ring[(k + 1) % 4]
            self.code(_Place(halfway(start, end), (centre, start, None, end), (centre,), ()))

    def visit(self, a: Post, c: Corners) -> None:
        child: list[Post | None] = []
        for k in range(4):
            start, end = c[k], c[(k + 1) % 4]
            child.append(halfway(start, end) if start and end else None)
        n = sum(1 for q in child if q and self.is_active(q))
        places = [place for k in range(4) if (place := self.place(a, c, child, k))]
        path, turn, told = 1, 0, False
        must_tell = not self.is_new(a)
        if must_tell and not places:
            raise PayloadError("a change is told below a post on which nothing hangs")
        for number, place in enumerate(places):
            place.count, place.path, place.turn = n, path, turn
            implied = must_tell and not told and number == len(places) - 1
            changed = self.code(place, implied)
            told |= changed
            path = path << 1 | changed
            turn = 4 if told else number + 1

    def place(self, a: Post, c: Corners, child: list[Post | None], k: int) -> _Place | None:
        corner = c[k]
        before, after = child[k - 1], child[k]
        existing = [q for q in (before, after) if q]
        if corner is None or not all(self.is_active(q) for q in existing):
            return None
        if before and after:
            around: Corners = before, a, after, corner
        else:
            around = existing[0], a, None, corner
        ends = [(a, c[1], c[3])]
        for index in ((k - 1) % 4, k):
            q, start, end = child[index], c[index], c[(index + 1) % 4]
            if q and start and end:
                ends.append((q, start, end))
        return _Place(halfway(a, corner), around, (a, *existing), tuple(ends))

    # --- one diamond

    def code(self, place: _Place, implied: bool = False) -> bool:
        """Reads a diamond; returns whether it was told as changed."""
        if self.held(place.post):
            return self.code_held(place, implied)
        anew = any(self.is_new(q) for q in place.neighbours) if place.neighbours else self.change.snapshot
        context = self.model.active[16 * (place.count - 1) + place.path] if anew else self.model.added[place.count]
        changed = implied or self.bits.bit(context)
        if changed:
            self.room -= len(parents(place.post, self.side))
            if self.room < 0:
                raise PayloadError("the payload adds more triangles than are accepted")
            self.change.added[place.post] = self.read_height(place)
            self.open(place)
        return changed

    def code_held(self, place: _Place, implied: bool) -> bool:
        p = place.post
        below = sum(1 for q in children(p, self.side) if self.held(q))
        changed = implied or self.bits.bit(self.model.touched[self.row(place, below)][place.turn])
        if not changed:
            return False
        if self.bits.bit(self.model.removed[below]):
            self.remove(p)
        else:
            self.open(place)
        return True

    def row(self, place: _Place, below: int) -> int:
        if below < 4:
            return below
        row = 4 + sum(1 for c in place.corners if c and self.held(halfway(place.post, c)))
        return row if row < 8 else min(13, 8 + level(place.post, self.exponent) // 4)

    def open(self, place: _Place) -> None:
        self.opened[level(place.post, self.exponent)].append((place.post, place.corners))

    def remove(self, p: Post) -> None:
        doomed = [p]
        while doomed:
            q = doomed.pop()
            if q not in self.change.removed:
                self.change.removed.add(q)
                doomed += [child for child in children(q, self.side) if self.held(child)]

    # --- its height

    def read_height(self, place: _Place) -> int:
        c0, c1, c2, c3 = place.corners
        base = self.height(c1) + self.height(c3)
        apexes = self.height(c0) + self.height(c2 or c0)
        expected = self.expected_length(place)
        size = self.read_size(self.read_length(expected), expected, apexes - base)
        height = (apexes + base) // 4 + size
        if not -(1 << 31) <= height < 1 << 31:
            raise PayloadError("a height outside 32 bits")
        self.mean += abs(size) - self.mean // 16
        return height

    def expected_length(self, place: _Place) -> int:
        if self.change.snapshot:
            return (self.mean // 16).bit_length()
        if not place.lengths_of:
            return 6
        sizes = [abs(self.height(q) - (self.height(z0) + self.height(z1)) // 2) for q, z0, z1 in place.lengths_of]
        return (sum(sizes) // len(sizes)).bit_length()

    def read_length(self, x: int) -> int:
        if x == 0 or self.bits.bit(self.model.is_long):
            y = x
            while y < 32 and self.bits.bit(self.model.longer[min(7, y - x)]):
                y += 1
        else:
            y = x - 1
            while y > 0 and self.bits.bit(self.model.shorter[min(7, x - 1 - y)]):
                y -= 1
        return y

    def read_size(self, length: int, x: int, slope: int) -> int:
        """The difference of `length` digits, where x were expected; `slope` is A - B."""
        if length == 0:
            return 0
        steep = slope.bit_length()
        t = (steep >= x) + (steep > x + 1)
        negative = self.bits.bit(self.model.negative[2 * t + (slope < 0)])
        size = 1
        if length > 1:
            size = 2 | self.bits.bit(self.model.second[max(0, min(15, 8 + length - x))])
        if length > 2:
            size = size << (length - 2) | self.bits.raw(length - 2)
        return -size if negative else size


def halfway(p: Post, q: Post) -> Post:
    """The middle of two posts."""
    return (p[0] + q[0]) // 2, (p[1] + q[1]) // 2


def decode(payload: bytes, base: Mapping[Post, int], exponent: int, max_triangles: int) -> Change:
    """What `payload` does to `base`: active posts with heights, the four corners of the root square among them.

    A snapshot looks at the corners of `base` only. At most `max_triangles` triangles may be added.
    """
    if not payload:
        raise PayloadError("an empty payload")
    if payload[0] & ~DELTA_BIT != VERSION:
        raise PayloadError(f"first byte {payload[0]:#04x}: this client reads version {VERSION} of the payload")
    return _Walk(payload, base, exponent, max_triangles).run()
