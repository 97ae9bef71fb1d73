/**
 * By how much a triangle is off: the height of the finest surface at the middle of its base, where it would be split next,
 * against the mesh there. The server tells those heights, each once.
 */

import { CoordinateFrame } from "../generated/sightline/v1/common_pb";
import type { Mesh, Vertex } from "../mesh/mesh";
import type { Server } from "../server/connection";

/** Heights asked for in one call, and kept in all. */
const MAX_ASKED = 20_000;
const MAX_KEPT = 400_000;

export class Errors {
  private readonly heights = new Map<number, number>();

  constructor(
    private readonly server: Server,
    private readonly metresPerUnit: number,
  ) {}

  /** Asks for what is missing for a mesh; whether something came. */
  async fetch(mesh: Mesh): Promise<boolean> {
    const missing = new Map<number, { x: number; y: number }>();
    mesh.walk((_, e0, e1) => {
      const middle = this.middle(mesh, e0, e1);
      if (middle && !this.heights.has(middle.key) && missing.size < MAX_ASKED) missing.set(middle.key, middle);
    });
    if (missing.size === 0) return false;
    if (this.heights.size + missing.size > MAX_KEPT) this.heights.clear();
    const places = [...missing.values()];
    const found = await this.server.terrain.getHeights({ frame: CoordinateFrame.GRID, x: places.map((p) => p.x), y: places.map((p) => p.y) });
    [...missing.keys()].forEach((key, n) => this.heights.set(key, found.known[n] ? (found.z[n] ?? NaN) : NaN));
    return true;
  }

  /** The error in metres of the triangle with this base; 0 at the finest level and where it is not known. */
  of(mesh: Mesh, e0: Vertex, e1: Vertex): number {
    const middle = this.middle(mesh, e0, e1);
    const height = middle && this.heights.get(middle.key);
    if (height === undefined || Number.isNaN(height)) return 0;
    return Math.abs(height - (e0.z + e1.z) / 2) * this.metresPerUnit;
  }

  private middle({ grid }: Mesh, e0: Vertex, e1: Vertex): { key: number; x: number; y: number } | undefined {
    const [x, y] = [(e0.i + e1.i) / 2, (e0.j + e1.j) / 2];
    const isPost = Number.isInteger(x) && Number.isInteger(y) && x < grid.nx && y < grid.ny;
    return isPost ? { key: grid.key(x, y), x, y } : undefined;
  }
}
