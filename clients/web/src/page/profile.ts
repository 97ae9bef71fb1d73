/** The plot of the selected line: the exact ground, each view's mesh, and the line. Distances and heights in metres. */

import type { QueryProfileResponse } from "../generated/sightline/v1/line_of_sight_pb";
import type { Point } from "../mesh/line";
import type { Piece } from "../mesh/section";
import { byId, make, metres } from "./dom";

const SVG = "http://www.w3.org/2000/svg";
const MARGIN = { left: 52, right: 12, top: 8, bottom: 20 };

export interface Plotted {
  readonly a: Point;
  readonly b: Point;
  readonly ground: QueryProfileResponse;
  readonly meshes: readonly { name: string; colour: string; pieces: readonly Piece[] }[];
  readonly colour: string;
  /** Where the line is first obstructed, as a part of it. */
  readonly obstruction: number | undefined;
  readonly planLengthM: number;
  readonly metresPerUnit: number;
}

export function plot(plotted: Plotted | undefined): void {
  const svg = byId<SVGSVGElement>("profile");
  const key = byId("profile-key");
  svg.replaceChildren();
  key.replaceChildren();
  if (!plotted) return;
  showKey(key, plotted);
  // With the key in place: what it leaves is what there is to draw on.
  const { clientWidth: width, clientHeight: height } = svg;
  if (width < 80 || height < 50) return;
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  const { a, b, ground, meshes, metresPerUnit } = plotted;
  const heights = [
    ...ground.ground.filter((_, n) => ground.known[n]), a.z, b.z,
    ...meshes.flatMap(({ pieces }) => pieces.flatMap((p) => [p.z0, p.z1])),
  ].map((z) => z * metresPerUnit);
  let [low, high] = [Math.min(...heights), Math.max(...heights)];
  const slack = Math.max((high - low) * 0.08, 2);
  [low, high] = [low - slack, high + slack];
  const x = (t: number) => MARGIN.left + t * (width - MARGIN.left - MARGIN.right);
  const y = (z: number) => MARGIN.top + ((high - z * metresPerUnit) / (high - low)) * (height - MARGIN.top - MARGIN.bottom);
  const add = (tag: string, attributes: Record<string, string | number>, text = "") => {
    const element = document.createElementNS(SVG, tag);
    for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, String(value));
    element.textContent = text;
    svg.append(element);
  };
  for (const [top, bottom] of stretches(ground, x, y, height - MARGIN.bottom)) {
    add("path", { class: "earth", d: `${top}${bottom}Z` });
    add("path", { class: "surface", d: top });
  }
  for (const step of ticks(low, high, 4)) {
    add("line", { class: "axis", x1: MARGIN.left, x2: width - MARGIN.right, y1: y(step / metresPerUnit), y2: y(step / metresPerUnit), opacity: 0.6 });
    add("text", { x: MARGIN.left - 7, y: y(step / metresPerUnit) + 4, "text-anchor": "end" }, `${step} m`);
  }
  for (const step of ticks(0, plotted.planLengthM, 6)) {
    const at = x(step / plotted.planLengthM);
    add("text", { x: at, y: height - 5, "text-anchor": step === 0 ? "start" : "middle" }, metres(step));
  }
  for (const { pieces, colour } of meshes) {
    const d = pieces.map((p, n) => `${n === 0 ? "M" : "L"}${x(p.from)} ${y(p.z0)}L${x(p.to)} ${y(p.z1)}`).join("");
    add("path", { class: "mesh", d, stroke: colour });
  }
  const t = plotted.obstruction;
  add("line", { class: "ray", x1: x(0), y1: y(a.z), x2: x(1), y2: y(b.z), stroke: plotted.colour });
  add("circle", { cx: x(0), cy: y(a.z), r: 4, fill: "#fff" });
  add("circle", { cx: x(1), cy: y(b.z), r: 4, fill: "#fff" });
  if (t !== undefined) add("circle", { cx: x(t), cy: y(a.z + t * (b.z - a.z)), r: 5, fill: "#10171c", stroke: plotted.colour, "stroke-width": 2.5 });
}

function showKey(key: HTMLElement, { meshes, colour: ray }: Plotted): void {
  const entry = (text: string, colour: string, isDashed: boolean) => {
    const item = make("span", text);
    const mark = make("i", "", isDashed ? "dashed" : "");
    mark.style.borderColor = colour;
    item.prepend(mark);
    key.append(item);
  };
  entry("exact ground", "#b9c8ae", false);
  for (const { name, colour } of meshes) entry(`mesh of view ${name}`, colour, true);
  entry("sight line", ray, false);
}

/** The known stretches of the ground: their upper edge as a path, and the rest of their outline. */
function stretches(ground: QueryProfileResponse, x: (t: number) => number, y: (z: number) => number, floor: number): [string, string][] {
  const found: [string, string][] = [];
  let run: string[] = [];
  let from = 0;
  ground.t.forEach((t, n) => {
    if (!ground.known[n]) return;
    if (run.length === 0) from = t;
    run.push(`${run.length === 0 ? "M" : "L"}${x(t).toFixed(1)} ${y(ground.ground[n] ?? 0).toFixed(1)}`);
    if (ground.knownAfter[n] && n + 1 < ground.t.length) return;
    if (run.length > 1) found.push([run.join(""), `L${x(t)} ${floor}L${x(from)} ${floor}`]);
    run = [];
  });
  return found;
}

/** Round numbers between two, about `number` of them. */
function ticks(low: number, high: number, number: number): number[] {
  const rough = (high - low) / number;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= rough) ?? rough;
  const first = Math.ceil(low / step) * step;
  return Array.from({ length: Math.max(0, Math.floor((high - first) / step) + 1) }, (_, n) => Number((first + n * step).toPrecision(12)));
}
