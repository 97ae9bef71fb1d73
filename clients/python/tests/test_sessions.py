"""Conformance, part 2: recorded sessions, the replica's hash and the verdicts on it after every frame."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from support import ROOT

from sightline import PayloadError, Scene, SceneError, Verdict
from sightline.v1 import scene_pb2

SESSIONS = sorted((ROOT / "clients/conformance").glob("*.jsonl"))
LETTERS = {Verdict.VISIBLE: "V", Verdict.BLOCKED: "B"}


def read(path: Path) -> tuple[Scene, list[tuple[scene_pb2.StreamSceneResponse, Any]]]:
    """A scene after its opening, and the messages that follow, with what must be held after them."""
    header, opening, *rest = map(json.loads, path.read_text().splitlines())
    opened = scene_pb2.StreamSceneResponse.FromString(bytes.fromhex(opening["message"])).opened
    scene = Scene(opened, header["max_triangles"], header["lines_expected"])
    parse = scene_pb2.StreamSceneResponse.FromString
    return scene, [(parse(bytes.fromhex(line["message"])), line.get("held")) for line in rest]


def held(scene: Scene) -> dict[str, Any]:
    assert scene.frame
    verdicts = scene.verdicts()
    return {
        "sequence": scene.frame.sequence,
        "epoch": scene.epoch,
        "triangles": scene.mesh.triangle_count,
        "hash": f"{scene.mesh.hash:016x}",
        "lines": list(map(str, verdicts)),
        "verdicts": "".join(LETTERS[v] for v in verdicts.values()),
        "unsatisfied": list(map(str, sorted(scene.unsatisfied))),
        "lacking": [lacking for _, lacking in sorted(scene.unsatisfied.items())],
        "off_ground": list(map(str, sorted(scene.off_ground))),
    }


def test_there_are_sessions() -> None:
    assert len(SESSIONS) >= 2


@pytest.mark.parametrize("path", SESSIONS, ids=lambda p: p.stem)
def test_every_frame_of_a_session(path: Path) -> None:
    scene, messages = read(path)
    frames = 0
    for message, wanted in messages:
        is_frame = scene.apply(message) == "frame"
        assert is_frame == (wanted is not None)
        if is_frame:
            assert held(scene) == wanted
            assert scene.disagreements() == []
            assert sum(1 for _ in scene.mesh) == scene.mesh.triangle_count
            frames += 1
    assert frames > 10


@pytest.mark.parametrize("path", SESSIONS, ids=lambda p: p.stem)
def test_a_frame_left_out_is_noticed_until_the_next_snapshot(path: Path) -> None:
    scene, messages = read(path)
    lost, refused, recovered = False, 0, 0
    for n, (message, wanted) in enumerate(messages):
        if n == 4:
            assert message.WhichOneof("response") == "frame"
            lost = True
            continue
        snapshot = message.WhichOneof("response") == "frame" and message.frame.base_sequence == 0
        if lost and wanted is not None and not snapshot:
            before = scene.mesh.posts
            with pytest.raises(SceneError):
                scene.apply(message)
            assert scene.mesh.posts == before
            refused += 1
            continue
        scene.apply(message)
        if snapshot and lost:
            lost, recovered = False, recovered + 1
        if wanted is not None:
            assert held(scene) == wanted
    assert refused and recovered


@pytest.mark.parametrize("path", SESSIONS, ids=lambda p: p.stem)
def test_a_view_opened_anew_keeps_its_mesh_until_a_snapshot(path: Path) -> None:
    first, messages = read(path)
    for message, _ in messages:
        first.apply(message)
    scene, messages = read(path)
    scene.keep_mesh(first)
    before = scene.mesh.posts
    assert before == first.mesh.posts and len(before) > 4 and scene.lines == {}
    delta = next(message for message, _ in messages if message.frame.base_sequence)
    with pytest.raises(SceneError):
        scene.apply(delta)
    assert scene.mesh.posts == before
    for message, wanted in messages:
        scene.apply(message)
        assert wanted is None or held(scene) == wanted


def test_a_frame_with_another_hash_or_count_is_refused() -> None:
    scene, messages = read(SESSIONS[0])
    frame = next(message for message, wanted in messages if wanted)
    update = next(message for message, wanted in messages if not wanted)
    scene.apply(update)
    for change in ("mesh_hash", "triangle_count"):
        wrong = scene_pb2.StreamSceneResponse()
        wrong.CopyFrom(frame)
        setattr(wrong.frame, change, getattr(wrong.frame, change) - 1)
        with pytest.raises(PayloadError):
            scene.apply(wrong)
        assert scene.frame is None and scene.mesh.triangle_count == 2
    scene.apply(frame)
    assert scene.frame is not None
