/** What is drawn between two frames: it moves without a jump, ends at the frame, and stands still under sight lines. */

import { expect, test } from "vitest";
import { Drawn, Morph, type Segment } from "../src/draw/morph";
import { Grid } from "../src/mesh/grid";
import { heightAt } from "../src/mesh/section";
import { Mesh } from "../src/mesh/mesh";
import { verdictOnMesh } from "../src/mesh/verdict";

const SIDE = 8;
const DURATION = 200;
const grid = new Grid(SIDE + 1, SIDE + 1, 3);
const heightOf = (i: number, j: number) => (i * 7919 + j * 104_729) % 61;

/** A choice of numbers that is the same for the same seed. */
function dice(seed: number): (below: number) => number {
  let state = seed;
  return (below) => {
    state = (Math.imul(state, 1_664_525) + 1_013_904_223) >>> 0;
    return Math.floor((state / 2 ** 32) * below);
  };
}

/** The mesh of some posts and all that they need. */
function mesh(next: (below: number) => number): Mesh {
  const made = new Mesh(grid, grid.corners().map(({ i, j }) => heightOf(i, j)));
  const wanted = new Set<number>();
  const need = (i: number, j: number): void => {
    const isCorner = (i === 0 || i === SIDE) && (j === 0 || j === SIDE);
    if (isCorner || wanted.has(grid.key(i, j))) return;
    wanted.add(grid.key(i, j));
    const [from, to] = grid.baseEnds(i, j);
    // The parents lie across the base, as far from the middle as its ends.
    for (const sign of [-1, 1]) {
      const [pi, pj] = [i + (sign * (to.j - from.j)) / 2, j - (sign * (to.i - from.i)) / 2];
      if (grid.has(pi, pj)) need(pi, pj);
    }
  };
  for (let n = next(10); n > 0; n--) need(next(SIDE + 1), next(SIDE + 1));
  return made.put([...wanted].map((key) => grid.post(key)).map(({ i, j }) => ({ i, j, z: heightOf(i, j) })));
}

const surface = (of: Drawn | Mesh) => Array.from({ length: (SIDE + 1) ** 2 }, (_, n) => heightAt(of, n % (SIDE + 1), Math.floor(n / (SIDE + 1))) ?? NaN);

const furthest = (p: number[], q: number[]) => Math.max(...p.map((z, k) => Math.abs(z - (q[k] ?? NaN))));

test("parents and base ends are those of the diamonds", () => {
  for (let i = 0; i <= SIDE; i++) {
    for (let j = 0; j <= SIDE; j++) {
      if ((i === 0 || i === SIDE) && (j === 0 || j === SIDE)) continue;
      for (const child of grid.children(i, j)) {
        const [from, to] = grid.baseEnds(child.i, child.j);
        expect([(from.i + to.i) / 2, (from.j + to.j) / 2]).toEqual([child.i, child.j]);
        const across = Math.hypot(i - child.i, j - child.j);
        expect(across).toBe(Math.hypot(from.i - child.i, from.j - child.j));
        expect((i - child.i) * (to.i - from.i) + (j - child.j) * (to.j - from.j)).toBe(0);
      }
    }
  }
});

test("it moves without a jump and ends at the frame", () => {
  for (let seed = 1; seed <= 6; seed++) {
    const next = dice(seed);
    let now = 0;
    const morph = new Morph(mesh(next), DURATION);
    for (let n = 0; n < 5; n++) {
      const frame = mesh(next);
      const before = surface(morph.drawn(now));
      morph.advance(frame, [], now);
      expect(furthest(surface(morph.drawn(now)), before), `seed ${seed}`).toBeLessThan(1e-9);
      const end = now + DURATION;
      expect(morph.isStill(end)).toBe(true);
      expect(furthest(surface(morph.drawn(end)), surface(frame)), `seed ${seed}`).toBeLessThan(1e-9);
      now += next(2 * DURATION);
    }
    morph.advance(mesh(next), [], now);
    const last = mesh(next);
    morph.advance(last, [], now + DURATION);
    morph.advance(last, [], now + 2 * DURATION);
    expect(morph.drawn(now + 2 * DURATION).heights, "what left is forgotten").toEqual(last.snapshot());
    expect(morph.drawn(now + 2 * DURATION).triangleCount).toBe(last.triangleCount);
  }
}, 30_000);

test("sight lines have the verdicts of the frame at every moment", () => {
  for (let seed = 1; seed <= 12; seed++) {
    const next = dice(seed);
    const place = () => ({ x: next(80) / 10, y: next(80) / 10, z: next(64) });
    const lines: Segment[] = Array.from({ length: 3 }, () => ({ a: place(), b: place() }));
    let now = 0;
    const morph = new Morph(mesh(next), DURATION);
    for (let n = 0; n < 4; n++) {
      const frame = mesh(next);
      morph.advance(frame, lines, now);
      for (const part of [0, 0.3, 0.9]) {
        const drawn = morph.drawn(now + part * DURATION);
        for (const { a, b } of lines) {
          // Doubles suffice here: nothing under a line slides, so all heights there are whole numbers.
          expect(verdictOnMesh(drawn, a, b), `seed ${seed}`).toBe(verdictOnMesh(frame, a, b));
        }
      }
      now += next(2 * DURATION);
    }
  }
});
