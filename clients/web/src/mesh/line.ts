/**
 * A line AB in plan against posts: which triangles of a mesh may lie under it. Floating point may only ever keep a triangle
 * that could have been dismissed.
 */

import type { Triangle, Walkable } from "./mesh";
import type { Post } from "./grid";

/** A point of the grid frame: posts east, posts north, height units. */
export interface Point {
  readonly x: number;
  readonly y: number;
  readonly z: number;
}

/** A sum of rounded terms is off by less than this part of the sum of their sizes: 8 roundings of 2^-53 (see each use). */
export const ROUNDING = 2 ** -50;
/** More than what underflow can take from any sum or product here; what is not beyond it is decided exactly. */
export const TINY = 1e-150;

/** Visits each triangle that AB may meet in plan, and few others. */
export function walkUnder(mesh: Walkable, a: Point, b: Point, visit: Triangle): void {
  const [west, east] = [Math.min(a.x, b.x), Math.max(a.x, b.x)];
  const [south, north] = [Math.min(a.y, b.y), Math.max(a.y, b.y)];
  const [dx, dy] = [b.x - a.x, b.y - a.y];
  // Two roundings in each factor, one in each product, one in the difference: less than ROUNDING of the sizes.
  const side = (p: Post): number => {
    const [left, right] = [dx * (p.j - a.y), dy * (p.i - a.x)];
    const value = left - right;
    return Math.abs(value) > ROUNDING * (Math.abs(left) + Math.abs(right)) + TINY ? Math.sign(value) : 0;
  };
  const isApart = (p: Post, q: Post, r: Post): boolean => {
    // Comparisons are exact.
    if (Math.max(p.i, q.i, r.i) < west || Math.min(p.i, q.i, r.i) > east) return true;
    if (Math.max(p.j, q.j, r.j) < south || Math.min(p.j, q.j, r.j) > north) return true;
    const first = side(p);
    return first !== 0 && side(q) === first && side(r) === first;
  };
  mesh.walk(visit, isApart);
}
