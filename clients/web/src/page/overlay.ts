/** The viewshed of the selected observer, gathered from tiles into one picture. */

import { AltitudeReference, CoordinateFrame } from "../generated/sightline/v1/common_pb";
import type { Overlay } from "../draw/ground";
import type { Space } from "../draw/space";
import type { Server } from "../server/connection";
import type { End } from "../server/exercise";

/** Posts along each side of a tile. */
const TILE = 64;
/** Most cells that the page asks for. */
const MAX_CELLS = 4_000_000;

/** The greatest radius in metres that is asked for on a terrain. */
export function greatestRadius(space: Space): number {
  const { scale } = space;
  return Math.sqrt((MAX_CELLS * scale.x * scale.y) / Math.PI);
}

export async function viewshed(server: Server, space: Space, observer: End, targetAbove: number, radius: number, signal: AbortSignal): Promise<Overlay | undefined> {
  const { scale, terrain } = space;
  const first = (at: number, step: number) => Math.max(0, Math.floor((at - radius) / step / TILE) * TILE);
  const end = (at: number, step: number, posts: number) => Math.min(posts, Math.ceil((at + radius) / step / TILE + 1) * TILE);
  const [firstI, firstJ] = [first(observer.east, scale.x), first(observer.north, scale.y)];
  const width = Math.ceil((end(observer.east, scale.x, terrain.nx) - firstI) / TILE) * TILE;
  const height = Math.ceil((end(observer.north, scale.y, terrain.ny) - firstJ) / TILE) * TILE;
  if (width <= 0 || height <= 0) return undefined;
  const cells = new Uint8Array(width * height);
  const request = {
    observer: {
      position: { x: observer.east, y: observer.north, z: observer.above },
      frame: CoordinateFrame.SCENE,
      altitude: AltitudeReference.ABOVE_GROUND,
    },
    targetHeightM: targetAbove,
    region: { case: "radiusM" as const, value: radius },
  };
  for await (const tile of server.lines.queryViewshed(request, { signal })) {
    const [i, j] = [tile.firstI - firstI, tile.firstJ - firstJ];
    if (i < 0 || j < 0 || i + TILE > width || j + TILE > height || tile.cells.length !== TILE * TILE) continue;
    for (let row = 0; row < TILE; row++) {
      cells.set(tile.cells.subarray(row * TILE, (row + 1) * TILE), (j + row) * width + i);
    }
  }
  return { cells, firstI, firstJ, width, height };
}
