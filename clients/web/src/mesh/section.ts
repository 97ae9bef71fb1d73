/**
 * What a mesh is like along a line, in doubles: for pictures, and to find what a pointer points at. It decides no verdict;
 * that is `verdict.ts`.
 */

import { type Point, walkUnder } from "./line";
import type { Vertex, Walkable } from "./mesh";

/** A stretch of AB over one triangle: `from` <= `to` as parts of AB, and the height of the mesh at both. */
export interface Piece {
  readonly from: number;
  readonly to: number;
  readonly z0: number;
  readonly z1: number;
}

/** The mesh under AB inside the grid, from A to B. */
export function section(mesh: Walkable, a: Point, b: Point): Piece[] {
  const pieces: Piece[] = [];
  walkUnder(mesh, a, b, (apex, e0, e1) => {
    const piece = cut(a, b, apex, e0, e1, mesh.grid.nx - 1, mesh.grid.ny - 1);
    if (piece) pieces.push(piece);
  });
  return pieces.sort((p, q) => p.from - q.from || p.to - q.to);
}

/** The part of AB at which it first goes below the mesh. */
export function firstBelow(mesh: Walkable, a: Point, b: Point): number | undefined {
  let first: number | undefined;
  walkUnder(mesh, a, b, (apex, e0, e1) => {
    const piece = cut(a, b, apex, e0, e1, mesh.grid.nx - 1, mesh.grid.ny - 1);
    if (!piece || (first !== undefined && piece.from >= first)) return;
    const over = (t: number, z: number) => a.z + t * (b.z - a.z) - z;
    const [from, to] = [over(piece.from, piece.z0), over(piece.to, piece.z1)];
    if (from >= 0 && to >= 0) return;
    const t = from < 0 ? piece.from : piece.from + (from / (from - to)) * (piece.to - piece.from);
    if (first === undefined || t < first) first = t;
  });
  return first;
}

/** Height of the mesh at a place of the plan; undefined beyond the grid. */
export function heightAt(mesh: Walkable, x: number, y: number): number | undefined {
  const here = { x, y, z: 0 };
  return section(mesh, here, here)[0]?.z0;
}

function cut(a: Point, b: Point, apex: Vertex, e0: Vertex, e1: Vertex, east: number, north: number): Piece | undefined {
  const [ux, uy, vx, vy] = [e0.i - apex.i, e0.j - apex.j, e1.i - apex.i, e1.j - apex.j];
  const square = ux * ux + uy * uy;
  const alongU = (p: Point) => ((p.x - apex.i) * ux + (p.y - apex.j) * uy) / square;
  const alongV = (p: Point) => ((p.x - apex.i) * vx + (p.y - apex.j) * vy) / square;
  const [ua, ub, va, vb] = [alongU(a), alongU(b), alongV(a), alongV(b)];
  let [from, to] = [0, 1];
  const constraints = [ua, ub, va, vb, 1 - ua - va, 1 - ub - vb, east - a.x, east - b.x, north - a.y, north - b.y];
  for (let n = 0; n < constraints.length; n += 2) {
    const [fa, fb] = [constraints[n] as number, constraints[n + 1] as number];
    if (fa < 0 && fb < 0) return undefined;
    if (fa < 0) from = Math.max(from, fa / (fa - fb));
    if (fb < 0) to = Math.min(to, fa / (fa - fb));
  }
  if (from > to) return undefined;
  const height = (t: number) =>
    apex.z + (ua + t * (ub - ua)) * (e0.z - apex.z) + (va + t * (vb - va)) * (e1.z - apex.z);
  return { from, to, z0: height(from), z1: height(to) };
}
