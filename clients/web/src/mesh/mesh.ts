/**
 * A replica of a mesh: its active posts with their heights, its hash, and the triangles that follow from them. A payload
 * that is invalid, or leads to another count or hash than its frame states, changes nothing.
 */

import { PayloadError } from "./bits";
import { type Grid, type Post } from "./grid";
import { add, postHash, subtract } from "./hash";
import { type Base, decode } from "./payload";

/** A corner of a triangle. */
export interface Vertex extends Post {
  readonly z: number;
}

/** A bintree triangle: its right-angled corner, and the ends of its base. Kept only as long as the call it is given to. */
export type Triangle = (apex: Vertex, e0: Vertex, e1: Vertex) => void;

/** Whether a triangle, and with it all below it, is left out of a walk. */
export type Dismiss = (apex: Post, e0: Post, e1: Post) => boolean;

/** Whatever has triangles that can be walked. */
export interface Walkable {
  readonly grid: Grid;
  readonly triangleCount: number;
  walk(visit: Triangle, isApart?: Dismiss): void;
}

/** Walks the triangles that follow from posts with heights, by their keys. */
export function descend(grid: Grid, heights: ReadonlyMap<number, number>, visit: Triangle, isApart?: Dismiss): void {
  const [sw, se, nw, ne] = grid.corners().map((p) => ({ ...p, z: heights.get(grid.key(p.i, p.j)) ?? 0 }));
  if (!sw || !se || !nw || !ne) return;
  const down = (apex: Vertex, e0: Vertex, e1: Vertex): void => {
    if (isApart?.(apex, e0, e1)) return;
    const i = (e0.i + e1.i) / 2;
    const j = (e0.j + e1.j) / 2;
    const z = Number.isInteger(i) && Number.isInteger(j) ? heights.get(grid.key(i, j)) : undefined;
    if (z === undefined) return visit(apex, e0, e1);
    const middle = { i, j, z };
    down(middle, apex, e0);
    down(middle, e1, apex);
  };
  down(se, sw, ne);
  down(nw, ne, sw);
}

/** What a frame says of its mesh. */
export interface Claim {
  readonly payload: Uint8Array;
  readonly isSnapshot: boolean;
  readonly triangles: number;
  readonly hash: bigint;
}

export class Mesh implements Base, Walkable {
  private heights = new Map<number, number>();
  private sum = 0n;
  private count = 2;

  /** The mesh of two triangles; `corners` in the order of `TerrainDescription.corner_heights`. */
  constructor(
    readonly grid: Grid,
    private readonly corners: readonly number[],
  ) {
    this.reset();
  }

  /** Number of triangles, those over padding included. */
  get triangleCount(): number {
    return this.count;
  }

  get hash(): bigint {
    return this.sum;
  }

  height(i: number, j: number): number | undefined {
    return this.heights.get(this.grid.key(i, j));
  }

  /** Heights of the active posts by their keys, as they are now. */
  snapshot(): Map<number, number> {
    return new Map(this.heights);
  }

  /** All active posts, in no order. */
  *posts(): Generator<Vertex> {
    for (const [key, z] of this.heights) yield { ...this.grid.post(key), z };
  }

  /** Adds posts by hand, ancestors first or not; for tests. */
  put(posts: Iterable<Vertex>): this {
    for (const { i, j, z } of posts) this.insert(this.grid.key(i, j), z);
    return this;
  }

  /** Becomes the mesh of a frame, or throws and stays as it was. */
  apply({ payload, isSnapshot, triangles, hash }: Claim, maxTriangles: number): void {
    const next = isSnapshot ? new Mesh(this.grid, this.corners) : this;
    const change = decode(payload, next, isSnapshot, maxTriangles);
    const undo: (() => void)[] = [];
    for (const key of change.removed) {
      const z = next.remove(key);
      undo.push(() => next.insert(key, z));
    }
    for (const [key, z] of change.added) {
      next.insert(key, z);
      undo.push(() => next.remove(key));
    }
    if (next.count === triangles && next.sum === hash && next.count <= maxTriangles) {
      [this.heights, this.sum, this.count] = [next.heights, next.sum, next.count];
      return;
    }
    const found = `${next.count} triangles and hash ${next.sum.toString(16)}`;
    for (const step of undo.reverse()) step();
    throw new PayloadError(`${found} came out, where the frame states ${triangles} and ${hash.toString(16)}`);
  }

  /**
   * Visits the triangles in the order of the hierarchy, leaving out those below a triangle that `isApart` dismisses. In
   * plan apex, e0, e1 turn clockwise.
   */
  walk(visit: Triangle, isApart?: Dismiss): void {
    descend(this.grid, this.heights, visit, isApart);
  }

  private reset(): void {
    this.grid.corners().forEach(({ i, j }, n) => {
      const z = this.corners[n];
      if (z === undefined) throw new RangeError(`${this.corners.length} corner heights`);
      this.heights.set(this.grid.key(i, j), z);
      this.sum = add(this.sum, postHash(i, j, z));
    });
  }

  private insert(key: number, z: number): void {
    const { i, j } = this.grid.post(key);
    this.heights.set(key, z);
    this.sum = add(this.sum, postHash(i, j, z));
    this.count += this.grid.parentCount(i, j);
  }

  private remove(key: number): number {
    const { i, j } = this.grid.post(key);
    const z = this.heights.get(key);
    if (z === undefined) throw new PayloadError(`post ${i}, ${j} is removed and was not there`);
    this.heights.delete(key);
    this.sum = subtract(this.sum, postHash(i, j, z));
    this.count -= this.grid.parentCount(i, j);
    return z;
  }
}
