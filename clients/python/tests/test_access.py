"""What a client says of itself, heard by a server of this test's own."""

from __future__ import annotations

import asyncio

import grpc.aio
import pytest

import sightline
from sightline.v1 import terrain_pb2, terrain_pb2_grpc


class Heard(terrain_pb2_grpc.TerrainServiceServicer):
    """Notes the metadata of calls, and answers with a terrain of four posts."""

    def __init__(self) -> None:
        self.tokens: list[object] = []

    async def DescribeTerrain(self, request, context):  # type: ignore[no-untyped-def]  # noqa: N802
        self.tokens.append(dict(context.invocation_metadata()).get("authorization"))
        terrain = terrain_pb2.TerrainDescription(nx=2, ny=2, corner_heights=[0] * 4)
        return terrain_pb2.DescribeTerrainResponse(terrain=terrain)


def test_a_token_goes_with_each_call_and_only_if_there_is_one() -> None:
    async def talk() -> list[object]:
        heard, server = Heard(), grpc.aio.server()
        terrain_pb2_grpc.add_TerrainServiceServicer_to_server(heard, server)
        port = server.add_insecure_port("127.0.0.1:0")
        await server.start()
        for access in (None, sightline.Access(token="secret")):
            async with await sightline.aio.connect(f"http://127.0.0.1:{port}", access=access) as client:
                assert (await client.terrain()).nx == 2
        await server.stop(None)
        return heard.tokens

    assert asyncio.run(talk()) == [None, "Bearer secret"]


def test_secrets_are_not_printed() -> None:
    access = sightline.Access(identity=(b"certificate", b"private"), token="secret")
    assert "secret" not in repr(access) and "private" not in repr(access)


def test_tls_to_a_server_without_it_is_an_error() -> None:
    async def talk() -> None:
        server = grpc.aio.server()
        port = server.add_insecure_port("127.0.0.1:0")
        await server.start()
        try:
            with pytest.raises(sightline.ConnectError):
                await sightline.aio.connect(f"https://localhost:{port}", connect_timeout_s=3)
        finally:
            await server.stop(None)

    asyncio.run(talk())
