/** Where the page looks at first, and its first sight lines: where the ground is most rugged. */

import { CoordinateFrame } from "../generated/sightline/v1/common_pb";
import type { Server } from "../server/connection";
import type { End } from "../server/exercise";
import type { Space } from "../draw/space";

/** Samples along each side of the terrain. */
const SAMPLES = 40;
/** Widest piece of ground that the page begins with, in metres. */
const WIDEST_M = 26_000;

export interface Start {
  /** The middle in the scene frame, and the height of the ground there, in metres. */
  readonly east: number;
  readonly north: number;
  readonly up: number;
  /** Width of what is looked at, in metres. */
  readonly width: number;
}

export async function findStart(server: Server, space: Space): Promise<Start> {
  const places = Array.from({ length: SAMPLES * SAMPLES }, (_, n) => ({
    x: (((n % SAMPLES) + 0.5) / SAMPLES) * space.east,
    y: ((Math.floor(n / SAMPLES) + 0.5) / SAMPLES) * space.north,
  }));
  const found = await server.terrain.getHeights({ frame: CoordinateFrame.SCENE, x: places.map((p) => p.x), y: places.map((p) => p.y) });
  const width = Math.min(WIDEST_M, space.east, space.north);
  const [middleX, middleY] = [space.east / 2, space.north / 2];
  let best = { east: middleX, north: middleY, up: 0, score: -Infinity };
  places.forEach((place, n) => {
    if (!found.known[n]) return;
    const isInside = (p: { x: number; y: number }) => Math.abs(p.x - place.x) <= width / 2 && Math.abs(p.y - place.y) <= width / 2;
    const near = places.flatMap((p, m) => (found.known[m] && isInside(p) ? [found.z[m] ?? 0] : []));
    const mean = near.reduce((sum, z) => sum + z, 0) / near.length;
    const spread = Math.sqrt(near.reduce((sum, z) => sum + (z - mean) ** 2, 0) / near.length);
    // A window that hangs over the edge has fewer samples; the nearer the middle, the better.
    const off = Math.hypot((place.x - middleX) / space.east, (place.y - middleY) / space.north);
    const score = spread * Math.sqrt(near.length) * (1 - 0.8 * off);
    if (score > best.score) best = { east: place.x, north: place.y, up: found.z[n] ?? 0, score };
  });
  return { ...best, width };
}

/** Heights over the ground of observers and targets, in metres: people, masts, and what flies low. */
const ABOVE_M = [2, 2, 15, 2, 60, 30] as const;

/** Ends of `number` lines around a place, the same for the same seed. */
export function scatter(space: Space, start: Start, number: number, seed: number): { a: End; b: End }[] {
  let state = seed >>> 0 || 1;
  // xorshift: a choice of places, nothing that must be random.
  const next = () => {
    state ^= state << 13;
    state >>>= 0;
    state ^= state >>> 17;
    state ^= state << 5;
    state >>>= 0;
    return state / 2 ** 32;
  };
  return Array.from({ length: number }, (_, n) => {
    const above = { a: ABOVE_M[n % 3] ?? 2, b: ABOVE_M[n % 6] ?? 2 };
    const from = { east: start.east + (next() - 0.5) * 0.5 * start.width, north: start.north + (next() - 0.5) * 0.5 * start.width };
    const [turn, reach] = [next() * 2 * Math.PI, (0.03 + 0.12 * next()) * start.width];
    const to = { east: from.east + reach * Math.cos(turn), north: from.north + reach * Math.sin(turn) };
    return { a: { ...space.clamp(from.east, from.north), above: above.a }, b: { ...space.clamp(to.east, to.north), above: above.b } };
  });
}
