"""Conformance, part 1: the wire vectors; and what must hold of any bytes."""

from __future__ import annotations

import random

import numpy as np
import pytest
from support import posts, wire_vectors

from sightline.diamond import children, parents
from sightline.errors import PayloadError
from sightline.mesh import Grid, Mesh, post_hash

LIMIT = 1 << 20


def meshes(vector: dict[str, str]) -> tuple[Mesh, Mesh]:
    """The mesh before the payload of a vector, and the one after it."""
    nx, ny = map(int, vector["grid"].split())
    exponent = (max(nx, ny) - 2).bit_length()
    corners = Mesh(Grid(nx, ny, exponent), map(int, vector["corners"].split()))
    return corners.with_posts(posts(vector.get("base", ""))), corners.with_posts(posts(vector["posts"]))


def apply(vector: dict[str, str], mesh: Mesh, payload: bytes | None = None, limit: int = LIMIT) -> None:
    snapshot = "base" not in vector
    payload = bytes.fromhex(vector["payload"]) if payload is None else payload
    mesh.apply(payload, int(vector["triangles"]), int(vector["hash"], 16), limit, snapshot=snapshot)


@pytest.mark.parametrize("vector", wire_vectors(), ids=lambda v: v["vector"])
def test_vectors(vector: dict[str, str]) -> None:
    mesh, expected = meshes(vector)
    apply(vector, mesh)
    assert mesh.posts == expected.posts
    assert mesh.triangle_count == expected.triangle_count == int(vector["triangles"])
    assert mesh.hash == expected.hash == int(vector["hash"], 16)
    assert sum(1 for _ in mesh) == mesh.triangle_count


def test_there_are_vectors() -> None:
    assert len(wire_vectors()) >= 9


def test_hash_examples_of_wire_md() -> None:
    assert post_hash(0, 0, -1) == 0xDB3CC8B8DF1167A2
    assert post_hash(1, 0, -32768) == 0xB3A64F69DF099E08
    assert post_hash(0, 1, 2147483647) == 0xC10064BC887C3785
    assert post_hash(1, 1, -2147483648) == 0xF169B38DA54D088F


@pytest.mark.parametrize("vector", wire_vectors(), ids=lambda v: v["vector"])
def test_damaged_payloads_change_nothing(vector: dict[str, str]) -> None:
    payload = bytes.fromhex(vector["payload"])
    dice = random.Random(len(payload))
    damaged = [payload[:n] for n in range(len(payload))] + [payload + b"\0", payload + b"\1"]
    for _ in range(60):
        at, bit = dice.randrange(len(payload)), 1 << dice.randrange(8)
        damaged.append(payload[:at] + bytes([payload[at] ^ bit]) + payload[at + 1 :])
    for other in damaged:
        mesh, _ = meshes(vector)
        before, hash_before = mesh.posts, mesh.hash
        with pytest.raises(PayloadError):
            apply(vector, mesh, other)
        assert (mesh.posts, mesh.hash) == (before, hash_before)


def test_a_budget_is_not_exceeded() -> None:
    for vector in wire_vectors():
        mesh, _ = meshes(vector)
        with pytest.raises(PayloadError):
            apply(vector, mesh, limit=int(vector["triangles"]) - 1)


def test_parents_and_children_are_inverse() -> None:
    side = 16
    inner = [(i, j) for i in range(side + 1) for j in range(side + 1) if (i % side, j % side) != (0, 0)]
    for p in inner:
        assert len(parents(p, side)) == (1 if 0 in p or side in p else 2) or p == (side // 2, side // 2)
        for q in children(p, side):
            assert p in parents(q, side)
    pairs = {(p, q) for p in inner for q in children(p, side)}
    corner_pairs = sum(1 for q in inner for p in parents(q, side) if p in inner)
    assert len(pairs) == corner_pairs


@pytest.mark.parametrize("vector", wire_vectors(), ids=lambda v: v["vector"])
def test_arrays_are_the_triangles(vector: dict[str, str]) -> None:
    mesh, _ = meshes(vector)
    apply(vector, mesh)
    vertices, triangles = mesh.vertices("grid"), mesh.triangles()
    drawn = {
        frozenset(corners)
        for corners in mesh
        if min(i for i, _ in corners) < mesh.grid.nx - 1 and min(j for _, j in corners) < mesh.grid.ny - 1
    }
    found = {frozenset((int(x), int(y)) for x, y, _ in vertices[t]) for t in triangles}
    assert found == drawn and len(triangles) == len(drawn)
    a, b, c = (vertices[triangles[:, k], :2] for k in range(3))
    assert (np.cross(np.pad(b - a, ((0, 0), (0, 1))), np.pad(c - a, ((0, 0), (0, 1))))[:, 2] > 0).all()
    assert all(mesh.height((int(x), int(y))) == z for x, y, z in vertices)
