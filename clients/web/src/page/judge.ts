/** What one view shows of each sight line, beside what the server states. */

import { Verdict } from "../generated/sightline/v1/common_pb";
import type { SightLineState } from "../generated/sightline/v1/exercise_pb";
import type { Mesh } from "../mesh/mesh";
import { type MeshVerdict, verdictOnMesh } from "../mesh/verdict";
import { disagrees } from "../scene";

/** Lines that a view judges; of more, those with the least ids. */
export const MAX_JUDGED = 2_000;

export const COLOURS = { VISIBLE: "#3fd3aa", BLOCKED: "#ff7466", UNKNOWN: "#a9b8c1", wrong: "#ff5fd7", named: "#ffc857" } as const;

export interface Judged {
  readonly line: SightLineState;
  /** The exact verdict on the view's own mesh; undefined for a line without ends. */
  readonly onMesh: MeshVerdict | undefined;
  /** Whether it comes out otherwise than on the terrain. */
  readonly isWrong: boolean;
  /** Whether the frame names it as too dear, and the triangles that it asked for then. */
  readonly lacking: number | undefined;
}

/** Judges lines on a mesh; what was judged `before` on the same mesh is not computed again. */
export function judge(
  mesh: Mesh,
  lines: Iterable<SightLineState>,
  named: ReadonlyMap<bigint, number>,
  before: ReadonlyMap<bigint, Judged>,
): Map<bigint, Judged> {
  const all = [...lines].sort((p, q) => (p.id < q.id ? -1 : 1)).slice(0, MAX_JUDGED);
  return new Map(all.map((line) => {
    const { a, b } = line.resolved ?? {};
    const known = before.get(line.id);
    const onMesh = known?.line === line ? known.onMesh : a && b ? verdictOnMesh(mesh, a, b) : undefined;
    return [line.id, { line, onMesh, isWrong: disagrees(line.verdict, onMesh), lacking: named.get(line.id) }];
  }));
}

export function stated(line: SightLineState): "VISIBLE" | "BLOCKED" | "UNKNOWN" {
  return line.verdict === Verdict.VISIBLE ? "VISIBLE" : line.verdict === Verdict.BLOCKED ? "BLOCKED" : "UNKNOWN";
}

/** A verdict as people say it. */
export const WORDS = { VISIBLE: "visible", BLOCKED: "blocked", UNKNOWN: "unknown" } as const;
