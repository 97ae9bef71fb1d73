from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from support import Server, sightline_binary, write_terrain

import sightline


@pytest.fixture(scope="session")
def database(tmp_path_factory: pytest.TempPathFactory) -> Path:
    binary = sightline_binary()
    if not binary.exists():
        pytest.fail(f"{binary} is missing: cargo build --release, or name another one in SIGHTLINE")
    folder = tmp_path_factory.mktemp("terrain")
    write_terrain(folder / "hills.asc")
    made = folder / "hills.sightline"
    subprocess.run([binary, "ingest", folder / "hills.asc", "-o", made, "--quiet"], check=True)
    return made


@pytest.fixture(scope="session")
def running(database: Path) -> Iterator[Server]:
    server = Server(database)
    server.start()
    yield server
    server.kill()


@pytest.fixture
def server(running: Server) -> Iterator[sightline.Client]:
    with sightline.connect(running.address) as client:
        yield client
