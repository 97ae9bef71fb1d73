/**
 * The verdict of a sight line on a mesh, exactly: BLOCKED when some point of the closed segment AB over the grid rectangle
 * [0, nx - 1] x [0, ny - 1] lies strictly below the mesh, else VISIBLE. Contact does not block.
 *
 * Over one triangle everything is a linear function of the place t along AB: how far the point is within each side of the
 * triangle and of the grid, t itself and 1 - t (all not negative where the triangle counts), and how far it is above the
 * triangle's plane. What counts is a closed interval of t, whose ends are roots of such functions, and the height is
 * least at one of them. With the values f and F of a function at A and B, its root is t = f / (f - F), and there another
 * function with values g and G has the value (f G - g F) / (f - F). So the verdict is made of signs of such 2 x 2
 * determinants: of doubles when the error bound leaves no doubt, of BigInt otherwise, for every finite double.
 */

import { type Point, ROUNDING, TINY, walkUnder } from "./line";
import type { Vertex, Walkable } from "./mesh";

export type MeshVerdict = "VISIBLE" | "BLOCKED";

/** How many signs each rung has told; only tests look at it. */
export interface Rungs {
  filtered: number;
  exact: number;
}

/** The exact verdict of AB on `mesh`; ends in the grid frame. */
export function verdictOnMesh(mesh: Walkable, a: Point, b: Point, rungs: Rungs = { filtered: 0, exact: 0 }): MeshVerdict {
  const line = new Line(a, b, rungs);
  const { nx, ny } = mesh.grid;
  let isBlocked = false;
  walkUnder(mesh, a, b, (apex, e0, e1) => {
    isBlocked ||= dips(line, apex, e0, e1, nx - 1, ny - 1);
  });
  return isBlocked ? "BLOCKED" : "VISIBLE";
}

/** Values at A and B as doubles, the greatest errors of these, and the true values times one positive number. */
interface Linear {
  readonly a: number;
  readonly b: number;
  readonly ea: number;
  readonly eb: number;
  readonly exact: () => readonly [bigint, bigint];
}

const FROM_A: Linear = { a: 0, b: 1, ea: 0, eb: 0, exact: () => [0n, 1n] };
const FROM_B: Linear = { a: 1, b: 0, ea: 0, eb: 0, exact: () => [1n, 0n] };

/** Whether AB is strictly below the triangle somewhere over it and over the grid. */
function dips(line: Line, apex: Vertex, e0: Vertex, e1: Vertex, east: number, north: number): boolean {
  // The legs are equally long, along the axes or the diagonals: length times (u0, u1) and (v0, v1), each -1, 0 or 1. So all
  // coefficients are whole numbers below 2^35, and exact: heights have 32 bits.
  const [u0, u1] = [Math.sign(e0.i - apex.i), Math.sign(e0.j - apex.j)];
  const [v0, v1] = [Math.sign(e1.i - apex.i), Math.sign(e1.j - apex.j)];
  const length = Math.max(Math.abs(e0.i - apex.i), Math.abs(e0.j - apex.j)) * (u0 * u0 + u1 * u1);
  const [dz0, dz1] = [e0.z - apex.z, e1.z - apex.z];
  const above = line.combine(apex, -u0 * dz0 - v0 * dz1, -u1 * dz0 - v1 * dz1, length, 0);
  if (above.a > above.ea && above.b > above.eb) return false;
  const sides = [
    line.combine(apex, u0, u1, 0, 0),
    line.combine(apex, v0, v1, 0, 0),
    line.combine(apex, -u0 - v0, -u1 - v1, 0, length),
  ];
  if (Math.max(apex.i, e0.i, e1.i) > east) sides.push(line.combine({ i: east, j: 0, z: 0 }, -1, 0, 0, 0));
  if (Math.max(apex.j, e0.j, e1.j) > north) sides.push(line.combine({ i: 0, j: north, z: 0 }, 0, -1, 0, 0));
  if (sides.some((f) => f.a < -f.ea && f.b < -f.eb)) return false;
  sides.push(FROM_A, FROM_B);
  return sides.some((f) => {
    const slope = line.slope(f);
    if (slope === 0) return false;
    const at = (g: Linear) => slope * line.determinant(f, g);
    return at(above) < 0 && sides.every((g) => g === f || at(g) >= 0);
  });
}

class Line {
  private scaled: { a: bigint[]; b: bigint[]; shift: bigint } | undefined;

  constructor(
    private readonly a: Point,
    private readonly b: Point,
    private readonly rungs: Rungs,
  ) {
    if (![a.x, a.y, a.z, b.x, b.y, b.z].every(Number.isFinite)) throw new RangeError("a coordinate is not finite");
  }

  /**
   * The function x (px - i) + y (py - j) + z (pz - h) + constant of a point p, with exact coefficients. A difference is
   * rounded once, a product once, and the sum of four terms three times: 5 roundings of 2^-53, fewer than the 8 allowed.
   */
  combine(origin: Vertex, x: number, y: number, z: number, constant: number): Linear {
    const at = (p: Point): [number, number] => {
      const terms = [x * (p.x - origin.i), y * (p.y - origin.j), z * (p.z - origin.z)] as const;
      const size = Math.abs(terms[0]) + Math.abs(terms[1]) + Math.abs(terms[2]) + Math.abs(constant);
      return [terms[0] + terms[1] + terms[2] + constant, size * ROUNDING + TINY];
    };
    const [a, ea] = at(this.a);
    const [b, eb] = at(this.b);
    const exact = (): readonly [bigint, bigint] => {
      const { a: wholeA, b: wholeB, shift } = this.whole();
      const at = (p: bigint[]) =>
        BigInt(x) * ((p[0] ?? 0n) - (BigInt(origin.i) << shift)) +
        BigInt(y) * ((p[1] ?? 0n) - (BigInt(origin.j) << shift)) +
        BigInt(z) * ((p[2] ?? 0n) - (BigInt(origin.z) << shift)) +
        (BigInt(constant) << shift);
      return [at(wholeA), at(wholeB)];
    };
    return { a, b, ea, eb, exact };
  }

  /** Sign of f - F. */
  slope(f: Linear): number {
    const value = f.a - f.b;
    const error = f.ea + f.eb + ROUNDING * (Math.abs(f.a) + Math.abs(f.b)) + TINY;
    return this.sign(value, error, () => {
      const [a, b] = f.exact();
      return a - b;
    });
  }

  /** Sign of f G - g F. Errors of the factors, of the two products and of the difference: see `combine`. */
  determinant(f: Linear, g: Linear): number {
    const [left, right] = [f.a * g.b, g.a * f.b];
    const error =
      Math.abs(f.a) * g.eb + Math.abs(g.b) * f.ea + f.ea * g.eb +
      Math.abs(g.a) * f.eb + Math.abs(f.b) * g.ea + g.ea * f.eb +
      ROUNDING * (Math.abs(left) + Math.abs(right)) + TINY * TINY;
    return this.sign(left - right, error, () => {
      const [[fa, fb], [ga, gb]] = [f.exact(), g.exact()];
      return fa * gb - ga * fb;
    });
  }

  private sign(value: number, error: number, exact: () => bigint): number {
    // Infinities and what comes of them fail both comparisons.
    if (value > error || value < -error) {
      this.rungs.filtered += 1;
      return value > 0 ? 1 : -1;
    }
    this.rungs.exact += 1;
    const truth = exact();
    return truth > 0n ? 1 : truth < 0n ? -1 : 0;
  }

  /** Both ends times 2^shift. */
  private whole(): { a: bigint[]; b: bigint[]; shift: bigint } {
    if (!this.scaled) {
      const parts = [this.a.x, this.a.y, this.a.z, this.b.x, this.b.y, this.b.z].map(decompose);
      const least = Math.min(0, ...parts.map((p) => p.exponent));
      const all = parts.map((p) => p.whole << BigInt(p.exponent - least));
      this.scaled = { a: all.slice(0, 3), b: all.slice(3), shift: BigInt(-least) };
    }
    return this.scaled;
  }
}

const view = new DataView(new ArrayBuffer(8));

/** A finite double as whole * 2^exponent. */
function decompose(value: number): { whole: bigint; exponent: number } {
  view.setFloat64(0, value);
  const bits = view.getBigUint64(0);
  const biased = Number((bits >> 52n) & 0x7ffn);
  const fraction = bits & ((1n << 52n) - 1n);
  const size = biased === 0 ? fraction : fraction | (1n << 52n);
  if (size === 0n) return { whole: 0n, exponent: 0 };
  return { whole: bits >> 63n === 1n ? -size : size, exponent: Math.max(biased, 1) - 1075 };
}
