/**
 * What a client knows of one view, from the messages received alone: its mesh, its sight lines, and which of them are
 * named. Messages are taken in order, so a recorded stream replays to the same state; one that does not fit throws and
 * changes nothing.
 */

import type {
  ExerciseUpdate, Frame, StreamSceneResponse, ViewOpened,
} from "./generated/sightline/v1/scene_pb";
import { Verdict } from "./generated/sightline/v1/common_pb";
import type { SightLineState } from "./generated/sightline/v1/exercise_pb";
import { Grid } from "./mesh/grid";
import { Mesh } from "./mesh/mesh";
import { type MeshVerdict, verdictOnMesh } from "./mesh/verdict";

/** Names the requirement that the eye is not under its own mesh. */
export const EYE = 2n ** 64n - 1n;
/** Most sight lines that a client keeps of one view. */
export const MAX_LINES = 1 << 20;

/** A message that does not fit what is known of the view. */
export class SceneError extends Error {
  override readonly name = "SceneError";
}

export class Scene {
  readonly mesh: Mesh;
  readonly lines = new Map<bigint, SightLineState>();
  /** Lines named as not holding on this mesh, with the triangles that they asked for beside the lines before them. */
  unsatisfied: ReadonlyMap<bigint, number> = new Map();
  /** Entities from whose ground this mesh is further off than they ask. */
  offGround: ReadonlySet<bigint> = new Set();
  epoch = 0n;
  private readonly version: string;
  /** The last frame applied. */
  frame: Frame | undefined;

  /**
   * Frames of more than `maxTriangles` triangles are refused. `linesExpected` is false for a view without an exercise:
   * then frames come without updates of sight lines. A view that is opened anew keeps the mesh that it had `before`, on the
   * same terrain, until its first frame, which is a snapshot.
   */
  constructor(
    opened: ViewOpened,
    public maxTriangles: number,
    private readonly linesExpected: boolean,
    before?: Scene,
  ) {
    const terrain = opened.terrain;
    if (!terrain) throw new SceneError("a view was opened without a terrain");
    this.version = terrain.version.join();
    this.mesh = before?.version === this.version
      ? before.mesh
      : new Mesh(new Grid(terrain.nx, terrain.ny, terrain.rootExponent), terrain.cornerHeights.map(Number));
  }

  apply(message: StreamSceneResponse): "exercise" | "frame" {
    const { response } = message;
    if (response.case === "exercise") this.update(response.value);
    else if (response.case === "frame") this.advance(response.value);
    else throw new SceneError("a message that has no place in an open stream");
    return response.case;
  }

  /** The exact verdict on this mesh of each sight line that has ends, by id in ascending order. */
  verdicts(): Map<bigint, MeshVerdict> {
    const ids = [...this.lines.keys()].sort((p, q) => (p < q ? -1 : 1));
    const found = new Map<bigint, MeshVerdict>();
    for (const id of ids) {
      const segment = this.lines.get(id)?.resolved;
      if (segment?.a && segment.b) found.set(id, verdictOnMesh(this.mesh, segment.a, segment.b));
    }
    return found;
  }

  /** Lines that come out otherwise on this mesh than on the terrain without being named: none, ever. */
  disagreements(): bigint[] {
    return [...this.verdicts()].filter(([id, found]) => {
      const stated = this.lines.get(id)?.verdict;
      return disagrees(stated, found) && !this.unsatisfied.has(id);
    }).map(([id]) => id);
  }

  private update(update: ExerciseUpdate): void {
    if (update.epoch < this.epoch) throw new SceneError(`an update for epoch ${update.epoch} after epoch ${this.epoch}`);
    if (this.lines.size + update.changed.length > MAX_LINES) throw new SceneError(`more than ${MAX_LINES} sight lines`);
    for (const id of update.removed) this.lines.delete(id);
    for (const line of update.changed) this.lines.set(line.id, line);
    this.epoch = update.epoch;
  }

  private advance(frame: Frame): void {
    if (this.linesExpected && frame.epoch !== this.epoch) {
      throw new SceneError(`frame ${frame.sequence} is of epoch ${frame.epoch}, the sight lines held of ${this.epoch}`);
    }
    const isSnapshot = frame.baseSequence === 0n;
    const held = this.frame?.sequence ?? 0n;
    if (!isSnapshot && frame.baseSequence !== held) {
      throw new SceneError(`frame ${frame.sequence} changes frame ${frame.baseSequence}, but frame ${held} is held`);
    }
    const unsatisfied = this.renamed(frame, isSnapshot);
    const claim = { payload: frame.mesh, isSnapshot, triangles: frame.triangleCount, hash: frame.meshHash };
    this.mesh.apply(claim, this.maxTriangles);
    this.unsatisfied = unsatisfied;
    const off = new Set(isSnapshot ? [] : this.offGround);
    for (const id of frame.noLongerOffGround) off.delete(id);
    for (const id of frame.nowOffGround) off.add(id);
    this.offGround = off;
    this.frame = frame;
  }

  private renamed(frame: Frame, isSnapshot: boolean): Map<bigint, number> {
    const named = new Map(isSnapshot ? [] : this.unsatisfied);
    for (const id of frame.noLongerUnsatisfied) {
      if (!named.delete(id)) throw new SceneError(`frame ${frame.sequence} takes back line ${id}, which was not named`);
    }
    for (const line of frame.nowUnsatisfied) {
      if (line.id !== EYE && !this.lines.has(line.id)) {
        throw new SceneError(`frame ${frame.sequence} names sight line ${line.id}, which is not known`);
      }
      named.set(line.id, line.lackingTriangles);
    }
    return named;
  }
}

/** Whether a mesh shows another verdict than the terrain has; UNKNOWN lines are not compared. */
export function disagrees(stated: Verdict | undefined, found: MeshVerdict | undefined): boolean {
  if (found === undefined) return false;
  return (stated === Verdict.VISIBLE && found === "BLOCKED") || (stated === Verdict.BLOCKED && found === "VISIBLE");
}

