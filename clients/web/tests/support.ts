/** What the tests share: where the suite's files are, and meshes made from them. */

import { readFileSync } from "node:fs";
import { Grid } from "../src/mesh/grid";
import { Mesh, type Vertex } from "../src/mesh/mesh";

/** A file of the repository. */
export const file = (path: string): string => readFileSync(new URL(`../../../${path}`, import.meta.url), "utf8");

export const hex = (digits: string): Uint8Array => Uint8Array.from(Buffer.from(digits, "hex"));

/** Exponent of the smallest root square over a grid. */
export const exponent = (nx: number, ny: number): number => Math.ceil(Math.log2(Math.max(nx, ny) - 1));

/** Posts written as `i,j,height`, with blanks between them. */
export const posts = (text: string): Vertex[] =>
  text.split(" ").filter(Boolean).map((post) => {
    const [i = NaN, j = NaN, z = NaN] = post.split(",").map(Number);
    return { i, j, z };
  });

/** Active posts in one order, to compare. */
export const listed = (mesh: Mesh): string[] => [...mesh.posts()].map(({ i, j, z }) => `${i},${j},${z}`).sort();

export const meshOf = (nx: number, ny: number, corners: number[], inner: Vertex[]): Mesh =>
  new Mesh(new Grid(nx, ny, exponent(nx, ny)), corners).put(inner);
