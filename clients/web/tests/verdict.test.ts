/** Conformance, part 4: verdicts on the mesh; and which rung of the predicates told them. */

import { expect, test } from "vitest";
import type { Point } from "../src/mesh/line";
import type { Mesh } from "../src/mesh/mesh";
import { type Rungs, verdictOnMesh } from "../src/mesh/verdict";
import { exponent, file, meshOf } from "./support";

/** Rows of a CSV file whose fields may stand in quotes. */
function rows(path: string): Record<string, string>[] {
  const [head = [], ...body] = file(path).trim().split(/\r?\n/).map((line) =>
    [...line.matchAll(/("([^"]*)"|[^,]*)(,|$)/g)].map((m) => m[2] ?? m[1] ?? ""));
  return body.map((fields) => Object.fromEntries(head.map((name, n) => [name, fields[n] ?? ""])));
}

function meshes(): Map<string, Mesh> {
  return new Map(rows("tests/conformance/mesh.csv").map((row) => {
    const heights = file(`tests/conformance/${row["grid"]}.csv`).trim().split(/\r?\n/).map((line) => line.split(",").map(Number));
    const [nx, ny] = [heights[0]?.length ?? 0, heights.length];
    const z = (i: number, j: number): number => heights[Math.min(j, ny - 1)]?.[Math.min(i, nx - 1)] ?? NaN;
    const s = 2 ** exponent(nx, ny);
    const closed = (row["closed_vertices"] ?? "").split(" ").map((pair) => pair.split(",").map(Number) as [number, number]);
    const inner = closed.filter(([i, j]) => !(i % s === 0 && j % s === 0)).map(([i, j]) => ({ i, j, z: z(i, j) }));
    const mesh = meshOf(nx, ny, [z(0, 0), z(s, 0), z(0, s), z(s, s)], inner);
    expect(mesh.triangleCount).toBe(Number(row["triangles"]));
    return [row["mesh"] ?? "", mesh];
  }));
}

test("conformance vectors, in both directions, and the filter tells most signs", () => {
  const all = meshes();
  const lines = rows("tests/conformance/mesh_sight_lines.csv");
  expect(lines.length).toBeGreaterThan(1000);
  const rungs: Rungs = { filtered: 0, exact: 0 };
  const wrong = lines.filter((line) => {
    const end = (which: string): Point => ({
      x: Number(line[`${which}x`]), y: Number(line[`${which}y`]), z: Number(line[`${which}z`]),
    });
    const mesh = all.get(line["mesh"] ?? "") as Mesh;
    const found = [verdictOnMesh(mesh, end("a"), end("b"), rungs), verdictOnMesh(mesh, end("b"), end("a"), rungs)];
    return found.some((verdict) => verdict !== line["verdict_on_mesh"]);
  });
  expect(wrong).toEqual([]);
  expect(rungs.exact).toBeGreaterThan(0);
  expect(rungs.filtered).toBeGreaterThan(2 * rungs.exact);
});

/** A pyramid: four triangles, 10 high in the middle of 4 x 4 cells. */
const peak = (): Mesh => meshOf(5, 5, [0, 0, 0, 0], [{ i: 2, j: 2, z: 10 }]);
const at = (x: number, y: number, z: number): Point => ({ x, y, z });
/** The next double below a positive one. */
const below = (x: number): number => {
  const bits = new BigUint64Array(new Float64Array([x]).buffer);
  bits[0] = (bits[0] ?? 0n) - 1n;
  return new Float64Array(bits.buffer)[0] ?? NaN;
};

test("contact does not block, one unit in the last place below does", () => {
  const mesh = peak();
  const [a, b, lower] = [at(0, 2, 12), at(4, 2, 8), at(4, 2, below(8))];
  for (const turn of [(p: Point) => p, (p: Point) => at(p.y, p.x, p.z)]) {
    expect(verdictOnMesh(mesh, turn(a), turn(b))).toBe("VISIBLE");
    expect(verdictOnMesh(mesh, turn(b), turn(a))).toBe("VISIBLE");
    expect(verdictOnMesh(mesh, turn(a), turn(lower))).toBe("BLOCKED");
    expect(verdictOnMesh(mesh, turn(lower), turn(a))).toBe("BLOCKED");
  }
  expect(verdictOnMesh(mesh, at(0, 0, 0), at(2, 2, 10))).toBe("VISIBLE");
  expect(verdictOnMesh(mesh, at(0, 0, 0), at(2, 2, below(10)))).toBe("BLOCKED");
});

test("lines in the plane of a slope, whose ends lose digits beside the summit: only the exact rung can tell", () => {
  const mesh = peak();
  const rungs: Rungs = { filtered: 0, exact: 0 };
  for (let n = 1; n <= 50; n++) {
    // x has 50 bits, so 5 x is exact; x - 2 and 5 x - 10 are not.
    const x = (n * 0x92779b5a913) * 2 ** -55;
    const high = at(1.5, 2, 7.5);
    expect(verdictOnMesh(mesh, at(x, 2, 5 * x), high, rungs)).toBe("VISIBLE");
    expect(verdictOnMesh(mesh, at(x, 2, below(5 * x)), high, rungs)).toBe("BLOCKED");
  }
  expect(rungs.exact).toBeGreaterThan(100);
});

test("only what is over the grid blocks", () => {
  const mesh = peak();
  expect(verdictOnMesh(mesh, at(-1, 1, -5), at(1, -1, -5))).toBe("BLOCKED");
  expect(verdictOnMesh(mesh, at(-1, 1, -5), at(1, -1.0000001, -5))).toBe("VISIBLE");
  expect(verdictOnMesh(mesh, at(5, 0, -5), at(5, 4, -5))).toBe("VISIBLE");
  const padded = meshOf(4, 5, [0, 0, 0, 0], []);
  expect(verdictOnMesh(padded, at(3.5, 1, -5), at(3.5, 3, -5))).toBe("VISIBLE");
  expect(verdictOnMesh(padded, at(3, 1, -5), at(3, 3, -5))).toBe("BLOCKED");
});

test("points, vertical lines, and the smallest numbers", () => {
  const mesh = peak();
  for (const [z, wanted] of [[10, "VISIBLE"], [below(10), "BLOCKED"]] as const) {
    expect(verdictOnMesh(mesh, at(2, 2, z), at(2, 2, z))).toBe(wanted);
    expect(verdictOnMesh(mesh, at(2, 2, 1e300), at(2, 2, z))).toBe(wanted);
  }
  expect(verdictOnMesh(mesh, at(1, 2, 5e-324), at(1, 2, 4e15))).toBe("BLOCKED");
  expect(verdictOnMesh(mesh, at(5e-324, 2, 5e-324), at(0, 2, 0))).toBe("BLOCKED");
});

test("a coordinate that is not finite is an error", () => {
  for (const bad of [NaN, Infinity]) expect(() => verdictOnMesh(peak(), at(bad, 0, 0), at(1, 1, 1))).toThrow(RangeError);
});
