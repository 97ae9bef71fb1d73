/** Where a terrain has no data, as a picture of the whole: ground is drawn there, filled in, but nobody knows it. */

import { CoordinateFrame } from "../generated/sightline/v1/common_pb";
import type { VoidMask } from "../draw/ground";
import type { Space } from "../draw/space";
import type { Server } from "../server/connection";

/** Most samples along a side. Of larger terrains every so many posts are asked for, and smaller holes may be missed. */
const SAMPLES = 512;
/** Samples of one call, of which few are under way at any time. */
const AT_ONCE = 65_536;

/** The posts along an axis that are asked for: all, or evenly spread ones from the first to the last. */
function spread(posts: number): number[] {
  const count = Math.min(posts, SAMPLES);
  return Array.from({ length: count }, (_, n) => Math.round((n * (posts - 1)) / (count - 1)));
}

/** Undefined where all posts are known. */
export async function findVoids(server: Server, space: Space): Promise<VoidMask | undefined> {
  if (space.terrain.voidPosts === 0n) return undefined;
  const [columns, rows] = [spread(space.terrain.nx), spread(space.terrain.ny)];
  const cells = new Uint8Array(columns.length * rows.length);
  const rowsAtOnce = Math.max(1, Math.floor(AT_ONCE / columns.length));
  for (let row = 0; row < rows.length; row += rowsAtOnce) {
    const some = rows.slice(row, row + rowsAtOnce);
    const found = await server.terrain.getHeights({
      frame: CoordinateFrame.GRID,
      x: some.flatMap(() => columns),
      y: some.flatMap((j) => columns.map(() => j)),
    });
    found.known.forEach((isKnown, n) => {
      cells[row * columns.length + n] = isKnown ? 0 : 255;
    });
  }
  return { cells, width: columns.length, height: rows.length };
}
