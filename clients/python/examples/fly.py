"""Registers sight lines, flies over them with two budgets at once, and compares what the two meshes say.

    python fly.py [ADDRESS]
"""

import asyncio
import sys

import numpy as np

import sightline
from sightline import AtEntity, Entity, Pose, Settings, SightLine

EXERCISE = "flight"
POSES = 12


async def fly(server: sightline.aio.Client, terrain: sightline.Terrain, triangles: int) -> dict[int, list[object]]:
    """The verdicts on the view's own mesh after each pose."""
    extent = terrain.scene_from_grid((terrain.nx - 1, terrain.ny - 1, terrain.heights[1]))
    poses = [Pose.looking(extent * (0.1 + 0.8 * t, 0.5, 1.3), extent * (0.5, 0.6, 0.5)) for t in np.linspace(0, 1, POSES)]
    found = {}
    async with await server.view(poses[0], Settings(triangles=triangles), exercise=EXERCISE) as view:
        await view.frame()
        for pose in poses[1:]:
            frame = await view.frame_of(await view.steer(pose))
            verdicts = view.scene.verdicts()
            found[frame.pose_sequence] = [v if n not in view.scene.unsatisfied else None for n, v in verdicts.items()]
        print(f"{triangles} triangles: {view.bytes_received} bytes, last bound {frame.bound_px:.1f} px")
    return found


async def main(address: str) -> None:
    async with await sightline.aio.connect(address) as server:
        terrain = await server.terrain()
        dice = np.random.default_rng(1)
        places = dice.uniform((0, 0), (terrain.nx - 1, terrain.ny - 1), (12, 2))
        entities = [Entity(n, (x, y, 2.0), frame="grid", altitude="agl") for n, (x, y) in enumerate(places)]
        lines = [SightLine(12 * a + b, AtEntity(a), AtEntity(b)) for a in range(12) for b in range(a)]
        await server.create_exercise(EXERCISE)
        try:
            await server.change_exercise(EXERCISE, put_entities=entities, put_lines=lines)
            few, many = await asyncio.gather(fly(server, terrain, 1_000), fly(server, terrain, 10_000))
        finally:
            await server.delete_exercise(EXERCISE)
    pairs = [pair for pose in few for pair in zip(few[pose], many[pose], strict=True)]
    compared = [(a, b) for a, b in pairs if a is not None and b is not None]
    print(f"{len(compared)} of {len(pairs)} verdicts compared, {sum(a != b for a, b in compared)} differ")


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1] if len(sys.argv) > 1 else "127.0.0.1:7410"))
