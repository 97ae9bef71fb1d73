/** Conformance, part 1: the wire vectors; and what must hold of any bytes. */

import { expect, test } from "vitest";
import { PayloadError } from "../src/mesh/bits";
import { postHash } from "../src/mesh/hash";
import type { Mesh } from "../src/mesh/mesh";
import { file, hex, listed, meshOf, posts } from "./support";

type Vector = Record<string, string>;

const vectors: Vector[] = file("proto/vectors/mesh.txt")
  .split("\n\n")
  .map((run) => run.split("\n").filter((line) => line && !line.startsWith("#")))
  .filter((lines) => lines.length > 0)
  .map((lines) => Object.fromEntries(lines.map((line) => [line.split(" ", 1)[0], line.split(" ").slice(1).join(" ")])));

const LIMIT = 1 << 20;

function mesh(vector: Vector, which: "base" | "posts"): Mesh {
  const [nx = 0, ny = 0] = (vector["grid"] ?? "").split(" ").map(Number);
  return meshOf(nx, ny, (vector["corners"] ?? "").split(" ").map(Number), posts(vector[which] ?? ""));
}

function apply(vector: Vector, to: Mesh, payload = hex(vector["payload"] ?? ""), limit = LIMIT): void {
  const isSnapshot = vector["base"] === undefined;
  to.apply({ payload, isSnapshot, triangles: Number(vector["triangles"]), hash: BigInt(`0x${vector["hash"]}`) }, limit);
}

test("there are vectors", () => expect(vectors.length).toBeGreaterThanOrEqual(9));

test.each(vectors)("vector $vector", (vector) => {
  const [found, wanted] = [mesh(vector, "base"), mesh(vector, "posts")];
  apply(vector, found);
  expect(listed(found)).toEqual(listed(wanted));
  expect(found.hash).toBe(wanted.hash);
  expect(found.triangleCount).toBe(Number(vector["triangles"]));
  let triangles = 0;
  found.walk(() => triangles++);
  expect(triangles).toBe(found.triangleCount);
});

test.each(vectors)("damaged bytes of $vector change nothing", (vector) => {
  const payload = hex(vector["payload"] ?? "");
  const beginnings = Array.from(payload, (_, n) => payload.slice(0, n));
  const longer = [0, 1].map((byte) => Uint8Array.from([...payload, byte]));
  const turned = Array.from({ length: Math.min(8 * payload.length, 400) }, (_, bit) =>
    payload.map((byte, n) => (n === bit >> 3 ? byte ^ (1 << (bit & 7)) : byte)),
  );
  const [found, before] = [mesh(vector, "base"), listed(mesh(vector, "base"))];
  for (const other of [...beginnings, ...longer, ...turned]) {
    expect(() => apply(vector, found, other)).toThrow(PayloadError);
    expect(found.hash).toBe(mesh(vector, "base").hash);
  }
  expect(listed(found)).toEqual(before);
});

test("a mesh beyond what the view asked for is refused", () => {
  for (const vector of vectors) {
    expect(() => apply(vector, mesh(vector, "base"), undefined, Number(vector["triangles"]) - 1)).toThrow(PayloadError);
  }
});

test("hashes worked by hand", () => {
  expect(postHash(0, 0, -1)).toBe(0xdb3cc8b8df1167a2n);
  expect(postHash(1, 0, -32768)).toBe(0xb3a64f69df099e08n);
  expect(postHash(0, 1, 2147483647)).toBe(0xc10064bc887c3785n);
  expect(postHash(1, 1, -2147483648)).toBe(0xf169b38da54d088fn);
});
