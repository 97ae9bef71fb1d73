/**
 * The decoder of mesh payloads, written from WIRE.md alone ("The walk"). It reads against a base that it does not change,
 * and answers what to add and what to remove; whatever is invalid is a `PayloadError`.
 *
 * ```text
 *     c3 ── child 2 ── c2     A post a with its corners. Child k lies halfway between c[k] and c[k+1], place k halfway
 *     │ ╲      │      ╱ │     between a and c[k]: the diamond with apexes child k-1 and child k, and base a c[k].
 *     │   (3)  │  (2)   │     On the border of the square, c2 is missing.
 *  child 3 ─── a ─── child 1
 *     │   (0)  │  (1)   │
 *     │ ╱      │      ╲ │
 *     c0 ── child 0 ── c1
 * ```
 */

import { BitReader, Context, PayloadError } from "./bits";
import type { Grid, Post } from "./grid";
import { HeightReader, at, length } from "./heights";

const VERSION = 2;
const DELTA = 64;
const ADDED = [[17, 8], [17, 8], [17, 8], [74, 8], [49, 8]] as const;
const REMOVED = [[255, 8], [205, 8], [1, 8], [1, 8], [1, 8]] as const;
const TOUCHED = [
  [112, 112, 160, 160, 6],
  [3, 3, 3, 3, 3],
  [50, 42, 68, 68, 3],
  [50, 72, 104, 104, 4],
  [108, 120, 160, 160, 6],
  [98, 125, 160, 160, 6],
  [65, 71, 127, 127, 6],
  [66, 87, 130, 130, 9],
  [210, 240, 250, 250, 12],
  [145, 152, 212, 212, 62],
  [147, 119, 170, 170, 62],
  [104, 132, 180, 180, 61],
  [95, 120, 161, 161, 25],
  [70, 81, 127, 127, 12],
];

/** The mesh that a payload is read against. */
export interface Base {
  readonly grid: Grid;
  /** Height of an active post, corners included. */
  height(i: number, j: number): number | undefined;
}

/** What a payload changes. */
export interface Change {
  /** Heights of the posts that come, by their numbers in the grid. */
  readonly added: ReadonlyMap<number, number>;
  /** Numbers of the posts that go. */
  readonly removed: ReadonlySet<number>;
}

/** A diamond that may be active: its post, and apex, base end, other apex (or none), other base end. */
interface Diamond extends Post {
  readonly level: number;
  readonly corners: readonly [Post, Post, Post | undefined, Post];
}

/** A diamond in the place from which it is coded. */
interface Place extends Diamond {
  /** Whether what it hangs on, or one of its apexes, was not in the base. */
  readonly isNearNew: boolean;
  /** Sizes of the residuals that foretell its own; none in a snapshot and for the first two levels. */
  readonly residuals: readonly number[];
}

interface Opened extends Diamond {
  readonly isNew: boolean;
}

/** How a place stands in its visit. */
interface Standing {
  /** Active children of the visited post. */
  readonly n: number;
  readonly path: number;
  readonly turn: number;
  /** Whether a change is certain, and so not coded. */
  readonly isCertain: boolean;
}

const FIRST: Standing = { n: 1, path: 1, turn: 0, isCertain: false };

/**
 * Reads a payload. `isSnapshot` says whether its frame is based on nothing; `maxTriangles` is the greatest number of
 * triangles that the posts added may have.
 */
export function decode(payload: Uint8Array, base: Base, isSnapshot: boolean, maxTriangles: number): Change {
  if (payload[0] !== (isSnapshot ? VERSION : VERSION | DELTA)) {
    throw new PayloadError(`first byte ${payload[0]} of a ${isSnapshot ? "snapshot" : "delta"}`);
  }
  return new Decoder(payload, base, isSnapshot, maxTriangles).run();
}

class Decoder {
  private readonly grid: Grid;
  private readonly bits: BitReader;
  private readonly heights: HeightReader;
  private readonly added = new Map<number, number>();
  private readonly removed = new Set<number>();
  private readonly opened: Opened[][];
  private triangles = 0;

  private readonly active = Array.from({ length: 64 }, () => new Context(128, 2));
  private readonly addedBits = ADDED.map(([a, n]) => new Context(a, n));
  private readonly removedBits = REMOVED.map(([a, n]) => new Context(a, n));
  private readonly touched = TOUCHED.map((row) => row.map((a) => new Context(a, 8)));

  constructor(
    payload: Uint8Array,
    private readonly base: Base,
    private readonly isSnapshot: boolean,
    private readonly maxTriangles: number,
  ) {
    this.grid = base.grid;
    this.bits = new BitReader(payload);
    this.heights = new HeightReader(this.bits);
    this.opened = Array.from({ length: 2 * this.grid.exponent }, () => []);
  }

  run(): Change {
    const levels = 2 * this.grid.exponent;
    if (levels > 0) this.begin();
    for (let level = 0; level <= levels - 3; level++) {
      for (const post of at(this.opened, level)) this.visit(post);
    }
    for (const post of this.opened.slice(Math.max(levels - 2, 0)).flat()) {
      if (!post.isNew) throw new PayloadError("a change is told below the finest level");
    }
    this.bits.finish();
    return { added: this.added, removed: this.removed };
  }

  /** Steps 1 and 2: the centre, and the posts in the middle of the square's sides. */
  private begin(): void {
    const s = this.grid.side;
    const around: [Post, Post, Post, Post] = [{ i: s, j: 0 }, { i: 0, j: 0 }, { i: 0, j: s }, { i: s, j: s }];
    const centre: Diamond = { i: s / 2, j: s / 2, level: 0, corners: around };
    this.code({ ...centre, isNearNew: this.isSnapshot, residuals: [] }, FIRST);
    if (this.after(centre) === undefined) return;
    const isNearNew = this.isNew(centre);
    for (let k = 0; k < 4; k++) {
      const [from, to] = [at(around, k), at(around, (k + 1) % 4)];
      this.code({ ...halfway(from, to), level: 1, corners: [centre, from, undefined, to], isNearNew, residuals: [] }, FIRST);
    }
  }

  /** Step 3: the diamonds that hang on a post. */
  private visit(a: Opened): void {
    const places = this.places(a);
    if (places.list.length === 0 && !a.isNew) throw new PayloadError("a post was opened that nothing can hang on");
    let path = 1;
    let hasChange = false;
    places.list.forEach((place, order) => {
      const isCertain = !a.isNew && !hasChange && order === places.list.length - 1;
      const changed = this.code(place, { n: places.n, path, turn: hasChange ? 4 : order, isCertain });
      path = 2 * path + (changed ? 1 : 0);
      hasChange ||= changed;
    });
  }

  private places(a: Opened): { n: number; list: Place[] } {
    const c = a.corners;
    const child = (k: number): Post | undefined => {
      const [from, to] = [c[k % 4], c[(k + 1) % 4]];
      return from && to && halfway(from, to);
    };
    const children = [0, 1, 2, 3].map(child);
    const isActive = children.map((p) => p !== undefined && this.after(p) !== undefined);
    const list: Place[] = [];
    for (let k = 0; k < 4; k++) {
      const corner = c[k];
      if (!corner) continue;
      const [before, here] = [(k + 3) % 4, k];
      const apexes = [before, here].filter((n) => children[n] !== undefined);
      if (!apexes.every((n) => isActive[n])) continue;
      const [first, second] = apexes.map((n) => at(children, n));
      if (!first) continue;
      const corners: Place["corners"] = apexes.length === 2 ? [first, a, second, corner] : [first, a, undefined, corner];
      const isNearNew = a.isNew || apexes.some((n) => this.isNew(children[n] as Post));
      const residuals = this.isSnapshot
        ? []
        : [this.residual(a, c[1], c[3]), ...apexes.map((n) => this.residual(children[n] as Post, c[n] as Post, c[(n + 1) % 4] as Post))];
      list.push({ ...halfway(a, corner), level: a.level + 2, corners, isNearNew, residuals });
    }
    return { n: isActive.filter(Boolean).length, list };
  }

  /** A diamond, held by the base or not; whether a change of it, or below it, is told. */
  private code(p: Place, standing: Standing): boolean {
    return this.base.height(p.i, p.j) === undefined ? this.codeAbsent(p, standing) : this.codeHeld(p, standing);
  }

  private codeAbsent(p: Place, { n, path, isCertain }: Standing): boolean {
    const context = p.isNearNew ? at(this.active, 16 * (n - 1) + path) : at(this.addedBits, n);
    if (!isCertain && !this.bits.bit(context)) return false;
    this.triangles += this.grid.parentCount(p.i, p.j);
    if (this.triangles > this.maxTriangles) throw new PayloadError(`more than ${this.maxTriangles} triangles`);
    const [c0, c1, c2, c3] = p.corners.map((c) => c && this.after(c));
    if (c0 === undefined || c1 === undefined || c3 === undefined) throw new PayloadError("a diamond without its corners");
    const height = this.heights.read(c1 + c3, c0 + (c2 ?? c0), this.expected(p));
    this.added.set(this.grid.key(p.i, p.j), height);
    this.open(p, true);
    return true;
  }

  private codeHeld(p: Place, { turn, isCertain }: Standing): boolean {
    const children = this.grid.children(p.i, p.j).filter((c) => this.base.height(c.i, c.j) !== undefined).length;
    if (!isCertain && !this.bits.bit(at(at(this.touched, this.row(p, children)), turn))) return false;
    if (this.bits.bit(at(this.removedBits, children))) this.remove(p);
    else this.open(p, false);
    return true;
  }

  /** The row of `touched`: how much of the base hangs on a diamond that has `children` in it. */
  private row(p: Diamond, children: number): number {
    if (children < 4) return children;
    const isHeld = (c: Post | undefined) =>
      c !== undefined && (p.i + c.i) % 2 === 0 && (p.j + c.j) % 2 === 0 && this.isInBase(halfway(p, c));
    const row = 4 + p.corners.filter(isHeld).length;
    return row === 8 ? Math.min(8 + Math.floor(p.level / 4), 13) : row;
  }

  private expected(p: Place): number {
    if (this.isSnapshot) return this.heights.expected();
    if (p.level < 2) return 6;
    return length(Math.floor(p.residuals.reduce((sum, r) => sum + r, 0) / p.residuals.length));
  }

  /** By how much a post stands off the middle of its base. */
  private residual(p: Post, end0: Post, end1: Post): number {
    const [z, z0, z1] = [this.after(p), this.after(end0), this.after(end1)];
    if (z === undefined || z0 === undefined || z1 === undefined) throw new PayloadError("a post without its base");
    return Math.abs(z - Math.floor((z0 + z1) / 2));
  }

  private open(p: Diamond, isNew: boolean): void {
    at(this.opened, p.level).push({ i: p.i, j: p.j, level: p.level, corners: p.corners, isNew });
  }

  /** Takes a post away with all that descends from it. */
  private remove(p: Post): void {
    const waiting = [p];
    for (let next = waiting.pop(); next; next = waiting.pop()) {
      const key = this.grid.key(next.i, next.j);
      if (this.removed.has(key)) continue;
      this.removed.add(key);
      waiting.push(...this.grid.children(next.i, next.j).filter((c) => this.isInBase(c)));
    }
  }

  private isInBase(p: Post): boolean {
    return this.base.height(p.i, p.j) !== undefined;
  }

  private isNew(p: Post): boolean {
    return !this.isInBase(p);
  }

  /** The height of a post that is active after this payload. */
  private after(p: Post): number | undefined {
    const key = this.grid.key(p.i, p.j);
    if (this.removed.has(key)) return undefined;
    return this.added.get(key) ?? this.base.height(p.i, p.j);
  }
}

function halfway(a: Post, b: Post): Post {
  return { i: (a.i + b.i) / 2, j: (a.j + b.j) / 2 };
}
