"""Diamonds of the bintree hierarchy: levels, parents and children of posts, by arithmetic on their indices.

A post is a pair `(i, j)` of a root square of `2**m` cells a side: `i` counts posts east, `j` posts north, from the
south-west corner. Every post but the four corners is the centre of one diamond. The tables are those of `proto/WIRE.md`.
"""

from __future__ import annotations

Post = tuple[int, int]


def lowest_bit(p: Post) -> int:
    """The lowest set bit of `i | j`; 0 for (0, 0)."""
    bits = p[0] | p[1]
    return bits & -bits


def is_square(p: Post) -> bool:
    """Whether the sides of p's diamond run along x and y: `i` and `j` share their lowest set bit."""
    b = lowest_bit(p)
    return bool(p[0] & b and p[1] & b)


def level(p: Post, exponent: int) -> int:
    """The level of the diamond at p, no corner, in a root square of `2**exponent` cells: 0 to `2 * exponent - 1`."""
    b = lowest_bit(p)
    return 2 * (exponent - b.bit_length()) + (0 if is_square(p) else 1)


def inside(p: Post, side: int) -> bool:
    """Whether p is a post of a root square of `side` cells."""
    return 0 <= p[0] <= side and 0 <= p[1] <= side


def corners(side: int) -> tuple[Post, Post, Post, Post]:
    """South-west, south-east, north-west and north-east: the order of `TerrainDescription.corner_heights`."""
    return (0, 0), (side, 0), (0, side), (side, side)


def parents(p: Post, side: int) -> list[Post]:
    """The posts that are active wherever p is: one on the border, else two."""
    (i, j), b = p, lowest_bit(p)
    if i & b and j & b:
        around = [(i + x, j + y) for x in (-b, b) for y in (-b, b)]
        found = [(x, y) for x, y in around if (x // (2 * b) + y // (2 * b)) % 2 == 1]
    elif i & b:
        found = [(i, j - b), (i, j + b)]
    else:
        found = [(i - b, j), (i + b, j)]
    return [q for q in found if inside(q, side)]


def children(p: Post, side: int) -> list[Post]:
    """The posts that p is a parent of, in the order of WIRE.md."""
    (i, j), b = p, lowest_bit(p)
    if i & b and j & b:
        found = [(i, j - b), (i - b, j), (i + b, j), (i, j + b)]
    elif b > 1:
        h = b // 2
        found = [(i - h, j - h), (i + h, j - h), (i - h, j + h), (i + h, j + h)]
    else:
        found = []
    return [q for q in found if inside(q, side)]
