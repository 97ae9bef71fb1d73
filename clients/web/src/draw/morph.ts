/**
 * Geomorphing: a post that comes slides from the middle of its base to its height, and one that goes slides back. It is
 * drawing only; verdicts are those of the frame's mesh, and no vertex of a triangle under a sight line ever slides: it
 * jumps. So each line has its verdict on what is drawn, too, at every moment. The same rule as in the Rust client
 * (`clients/rust/src/morph.rs`).
 */

import type { Grid } from "../mesh/grid";
import { type Point, walkUnder } from "../mesh/line";
import { type Dismiss, type Mesh, type Triangle, type Walkable, descend } from "../mesh/mesh";

/** A line in plan and height, grid frame. */
export interface Segment {
  readonly a: Point;
  readonly b: Point;
}

interface Slide {
  /** Where it has its own height. */
  readonly height: number;
  readonly comes: boolean;
  /** How much of it is there at `since`: 0 on its base, 1 at its own height. */
  readonly share: number;
  readonly since: number;
}

/** What is drawn: heights that need not be whole numbers, by the keys of their posts. */
export class Drawn implements Walkable {
  constructor(
    readonly grid: Grid,
    readonly heights: ReadonlyMap<number, number>,
  ) {}

  /** Those of posts that are leaving included. */
  get triangleCount(): number {
    let count = 2 - 4;
    for (const key of this.heights.keys()) {
      const { i, j } = this.grid.post(key);
      count += this.isCorner(i, j) ? 1 : this.grid.parentCount(i, j);
    }
    return count;
  }

  walk(visit: Triangle, isApart?: Dismiss): void {
    descend(this.grid, this.heights, visit, isApart);
  }

  private isCorner(i: number, j: number): boolean {
    const { side } = this.grid;
    return (i === 0 || i === side) && (j === 0 || j === side);
  }
}

/** What is drawn of one view from frame to frame. Times are in milliseconds of a clock that does not go back. */
export class Morph {
  private frame: ReadonlyMap<number, number>;
  private readonly sliding = new Map<number, Slide>();

  /** Nothing slides yet: `mesh` is drawn as it is. Slides take `duration`, above 0. */
  constructor(
    mesh: Mesh,
    private readonly duration: number,
  ) {
    this.grid = mesh.grid;
    this.frame = mesh.snapshot();
  }

  private readonly grid: Grid;

  /** Takes the mesh of the next frame; the triangles under `lines` stand still. */
  advance(mesh: Mesh, lines: readonly Segment[], now: number): void {
    this.settle(now);
    const before = new Drawn(this.grid, this.frame);
    this.frame = mesh.snapshot();
    const note = (key: number, height: number, comes: boolean) => {
      const was = this.sliding.get(key);
      this.sliding.set(key, { height, comes, share: was ? this.share(was, now) : comes ? 0 : 1, since: now });
    };
    for (const [key, z] of this.frame) if (!before.heights.has(key)) note(key, z, true);
    for (const [key, z] of before.heights) if (!this.frame.has(key)) note(key, z, false);
    for (const key of [...this.under(before, lines), ...this.under(mesh, lines)]) this.jump(key);
    // What has not jumped may still divide the triangles under a line.
    for (;;) {
      const late = [...this.under(this.drawn(now), lines)].filter((key) => this.sliding.has(key));
      if (late.length === 0) return;
      for (const key of late) this.jump(key);
    }
  }

  drawn(now: number): Drawn {
    const heights = new Map(this.frame);
    // Coarse posts first: where one slides from depends on them.
    const bit = (key: number) => {
      const { i, j } = this.grid.post(key);
      return (i | j) & -(i | j);
    };
    const coarseFirst = [...this.sliding].map(([key, slide]) => ({ key, slide, bit: bit(key) })).sort((p, q) => q.bit - p.bit);
    for (const { key, slide } of coarseFirst) {
      const { i, j } = this.grid.post(key);
      const [from, to] = this.grid.baseEnds(i, j).map((end) => heights.get(this.grid.key(end.i, end.j)) ?? slide.height);
      const base = ((from ?? 0) + (to ?? 0)) / 2;
      const share = this.share(slide, now);
      heights.set(key, share === 1 ? slide.height : base + share * (slide.height - base));
    }
    return new Drawn(this.grid, heights);
  }

  /** Whether what is drawn is the frame. */
  isStill(now: number): boolean {
    return [...this.sliding.values()].every((slide) => this.isDone(slide, now));
  }

  private share({ share, since, comes }: Slide, now: number): number {
    const gone = Math.max(0, (now - since) / this.duration);
    return comes ? Math.min(share + gone, 1) : Math.max(share - gone, 0);
  }

  private isDone(slide: Slide, now: number): boolean {
    return this.share(slide, now) === (slide.comes ? 1 : 0);
  }

  /** Forgets slides that are done; a post that left stays as long as one that hangs on it is on its way. */
  private settle(now: number): void {
    const bitOf = ({ i, j }: { i: number; j: number }) => (i | j) & -(i | j);
    const done = [...this.sliding].filter(([, slide]) => this.isDone(slide, now)).map(([key]) => ({ key, post: this.grid.post(key) }));
    // Fine posts first; of equal ones those that lie in the middle of a side before those in the middle of a square.
    const isSquare = ({ i, j }: { i: number; j: number }) => ((i & bitOf({ i, j })) !== 0 && (j & bitOf({ i, j })) !== 0 ? 1 : 0);
    done.sort((p, q) => bitOf(p.post) - bitOf(q.post) || isSquare(p.post) - isSquare(q.post));
    for (const { key, post } of done) {
      const hangs = () => this.grid.children(post.i, post.j).some((child) => this.sliding.has(this.grid.key(child.i, child.j)));
      if (this.sliding.get(key)?.comes || !hangs()) this.sliding.delete(key);
    }
  }

  /** Ends a slide at once, and with a post that leaves those that hang on it. */
  private jump(key: number): void {
    const slide = this.sliding.get(key);
    if (!slide) return;
    this.sliding.delete(key);
    if (slide.comes) return;
    const { i, j } = this.grid.post(key);
    for (const child of this.grid.children(i, j)) this.jump(this.grid.key(child.i, child.j));
  }

  /** Keys of the vertices of the triangles that lines may meet. */
  private under(mesh: Walkable, lines: readonly Segment[]): Set<number> {
    const keys = new Set<number>();
    for (const { a, b } of lines) {
      walkUnder(mesh, a, b, (...corners) => {
        for (const { i, j } of corners) keys.add(this.grid.key(i, j));
      });
    }
    return keys;
  }
}
