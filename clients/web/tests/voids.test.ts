/** Where the page shows that there is no data. */

import { expect, test } from "vitest";
import type { Space } from "../src/draw/space";
import { findVoids } from "../src/page/voids";
import type { Server } from "../src/server/connection";

/** A terrain whose posts are void where `isVoid` says so, and how many calls it was asked in. */
function terrain(nx: number, ny: number, isVoid: (i: number, j: number) => boolean) {
  let calls = 0;
  const getHeights = async ({ x, y }: { x: number[]; y: number[] }) => {
    calls++;
    expect(x.length).toBeLessThanOrEqual(65_536);
    return { known: x.map((i, n) => !isVoid(i, y[n] as number)) };
  };
  const server = { terrain: { getHeights } } as unknown as Server;
  const space = { terrain: { nx, ny, voidPosts: 1n } } as unknown as Space;
  return { server, space, calls: () => calls };
}

test("every post of a small terrain has its cell", async () => {
  const small = terrain(5, 3, (i, j) => i === 3 && j === 1);
  const mask = await findVoids(small.server, small.space);
  expect([mask?.width, mask?.height]).toEqual([5, 3]);
  expect([...(mask?.cells ?? [])].flatMap((cell, n) => (cell ? [n] : []))).toEqual([1 * 5 + 3]);
});

test("of a large terrain posts from the first to the last are asked for, in calls of a bounded size", async () => {
  const large = terrain(3601, 2000, (i, j) => i === 3600 || j === 0);
  const mask = await findVoids(large.server, large.space);
  expect([mask?.width, mask?.height, large.calls()]).toEqual([512, 512, 4]);
  const cells = mask?.cells ?? new Uint8Array();
  expect(cells.every((cell, n) => (cell === 255) === (n < 512 || n % 512 === 511))).toBe(true);
});

test("a terrain without voids is not asked", async () => {
  const whole = terrain(5, 3, () => true);
  const space = { terrain: { ...whole.space.terrain, voidPosts: 0n } } as unknown as Space;
  expect(await findVoids(whole.server, space)).toBeUndefined();
  expect(whole.calls()).toBe(0);
});
