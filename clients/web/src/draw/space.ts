/**
 * The frames of one terrain. *Grid*: posts and height units. *Scene*: metres east, north and up of post (0, 0). *Local*: the
 * scene frame moved to the middle of the terrain, so that the singles of a graphics card keep their digits.
 */

import { Vector3 } from "three";
import type { TerrainDescription } from "../generated/sightline/v1/terrain_pb";
import type { Point } from "../mesh/line";

export class Space {
  readonly scale: Point;
  /** The local frame's origin, in the scene frame. */
  private readonly origin: Point;
  /** Metres from the first to the last post. */
  readonly east: number;
  readonly north: number;
  /** Lowest and highest known ground, in metres in the local frame. */
  readonly low: number;
  readonly high: number;

  constructor(readonly terrain: TerrainDescription) {
    this.scale = { x: terrain.metresPerPostEast, y: terrain.metresPerPostNorth, z: terrain.metresPerHeightUnit };
    this.east = (terrain.nx - 1) * this.scale.x;
    this.north = (terrain.ny - 1) * this.scale.y;
    const [low, high] = [terrain.minHeight * this.scale.z, terrain.maxHeight * this.scale.z];
    this.origin = { x: this.east / 2, y: this.north / 2, z: low };
    [this.low, this.high] = [0, high - low];
  }

  localFromGrid(p: Point, into = new Vector3()): Vector3 {
    const { scale, origin } = this;
    return into.set(p.x * scale.x - origin.x, p.y * scale.y - origin.y, p.z * scale.z - origin.z);
  }

  gridFromLocal(p: Vector3): Point {
    const { scale, origin } = this;
    return { x: (p.x + origin.x) / scale.x, y: (p.y + origin.y) / scale.y, z: (p.z + origin.z) / scale.z };
  }

  sceneFromLocal(p: Vector3): Point {
    return { x: p.x + this.origin.x, y: p.y + this.origin.y, z: p.z + this.origin.z };
  }

  /** A place of the plan, kept inside the grid. */
  clamp(east: number, north: number): { east: number; north: number } {
    return { east: Math.min(Math.max(east, 0), this.east), north: Math.min(Math.max(north, 0), this.north) };
  }
}

/** Length of a line of the grid frame in the scene frame, in metres. */
export function lengthM(space: Space, a: Point, b: Point): number {
  const { scale } = space;
  return Math.hypot((b.x - a.x) * scale.x, (b.y - a.y) * scale.y, (b.z - a.z) * scale.z);
}
