"""The examples run, and the README's program is one of them and prints what stands there."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from support import ROOT, Server, sightline_binary

CLIENT = ROOT / "clients/python"


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server on the terrain of the demo."""
    made = tmp_path_factory.mktemp("demo") / "demo.sightline"
    subprocess.run([sightline_binary(), "ingest", ROOT / "src/cli/demo/jacksboro.tif", "-o", made, "--quiet"], check=True)
    server = Server(made)
    server.start()
    yield server
    server.kill()


def run(program: str, *arguments: str, folder: Path) -> str:
    command = [sys.executable, "-c", program, *arguments]
    environment = os.environ | {"MPLBACKEND": "Agg"}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_readme_shows_ten_lines_and_their_output(demo: Server, tmp_path: Path) -> None:
    program = (CLIENT / "examples/ten_lines.py").read_text()
    assert sum(1 for line in program.splitlines() if line.strip()) == 10
    readme = (CLIENT / "README.md").read_text()
    assert f"```python\n{program}```" in readme
    (shown,) = re.findall(r"It prints.*?```text\n(.*?)```", readme, re.DOTALL)
    assert run(program.replace("127.0.0.1:7410", demo.address), folder=tmp_path) == shown


def test_flying(demo: Server, tmp_path: Path) -> None:
    said = run((CLIENT / "examples/fly.py").read_text(), demo.address, folder=tmp_path)
    compared = re.search(r"(\d+) of (\d+) verdicts compared, 0 differ", said)
    assert compared and int(compared[1]) > 0, said


def test_pictures(demo: Server, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    run((CLIENT / "examples/pictures.py").read_text(), demo.address, folder=tmp_path)
    assert all((tmp_path / f"{name}.png").stat().st_size > 10_000 for name in ("profile", "viewshed", "mesh"))
