/** What the server says of one line, in a sentence. */

import type { Space } from "../draw/space";
import { lengthM } from "../draw/space";
import type { SightLineState } from "../generated/sightline/v1/exercise_pb";
import type { QueryLineOfSightResponse } from "../generated/sightline/v1/line_of_sight_pb";
import { UnknownReason } from "../generated/sightline/v1/common_pb";
import { make, metres } from "./dom";
import { WORDS, stated } from "./judge";

export function answer(line: SightLineState, los: QueryLineOfSightResponse, space: Space): (Node | string)[] {
  const { a, b } = line.resolved ?? {};
  if (!a || !b) return [];
  const verdict = stated(line);
  const unit = space.scale.z;
  const head = make("b", WORDS[verdict].toUpperCase(), verdict.toLowerCase());
  const parts: string[] = [];
  if (verdict === "BLOCKED" && los.firstFromA) {
    parts.push(`first obstruction ${metres(los.firstFromA.rangeM)} from the observer`);
    if (los.deepest !== undefined) parts.push(`${metres(los.deepest * unit)} below ground at the deepest`);
    if (los.leastTargetZ !== undefined) parts.push(`visible from ${metres((los.leastTargetZ - b.z) * unit)} higher`);
  } else if (verdict === "VISIBLE") {
    if (los.grazes) parts.push("it touches the ground on its way");
    else if (los.leastClearance !== undefined) parts.push(`least clearance ${metres(los.leastClearance * unit)}`);
  } else if (line.unknownReason === UnknownReason.UNKNOWN_GROUND) {
    parts.push("it passes ground that nobody has measured");
  }
  const rest = [`Line ${line.id}, ${metres(lengthM(space, a, b))}: `, head, ...(parts.length ? [` — ${parts.join(", ")}`] : [])];
  return [...rest, make("span", " (exact, on the finest terrain)", "unknown")];
}
