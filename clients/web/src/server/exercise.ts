/**
 * The page's sight lines and the exercise on the server that holds them. The page's own list is the source: it is
 * registered anew when the server comes back without it. Changes are sent one at a time, the newest state of each line only.
 *
 * All of it is under a lease that the page's views hold: a page that vanishes leaves nothing for long.
 */

import { create } from "@bufbuild/protobuf";
import { AltitudeReference, CoordinateFrame } from "../generated/sightline/v1/common_pb";
import { AnchorSchema, Fidelity, type SightLineState, SightLineSchema } from "../generated/sightline/v1/exercise_pb";
import { CALL_MS, Code, ConnectError, type Server } from "./connection";

/** How long what the page has registered outlives its views, in seconds: longer than a lost connection takes to come back. */
const LEASE_S = 60;

/** An end of a line: metres east and north of post (0, 0), metres above the ground there. */
export interface End {
  readonly east: number;
  readonly north: number;
  readonly above: number;
}

export interface OwnLine {
  readonly id: bigint;
  readonly a: End;
  readonly b: End;
}

export interface Asked {
  readonly fidelity: Fidelity;
  /** Of fidelity OBSTRUCTION, in metres. */
  readonly distance: number;
}

export class OwnExercise {
  readonly own = new Map<bigint, OwnLine>();
  /** All lines of the exercise as the server states them, at `epoch`. */
  stated = new Map<bigint, SightLineState>();
  epoch = 0n;
  asked: Asked = { fidelity: Fidelity.VERDICT, distance: 100 };

  private readonly dirty = new Set<bigint>();
  private readonly gone = new Set<bigint>();
  /** Lines of the page that the server has accepted. */
  private readonly registered = new Set<bigint>();
  /** Whether the server has the exercise, as far as is known. */
  private isThere = false;
  private isSending = false;
  private isRefreshing = false;
  private mustRefresh = false;

  constructor(
    private readonly server: Server,
    readonly name: string,
    /** Of the lease. */
    readonly owner: string,
    /** Whether others may have made the exercise: then it stays when the lease has run out. */
    private readonly isShared: boolean,
    /** Told when the stated lines have changed. */
    private readonly changed: () => void,
    private readonly failed: (error: unknown) => void,
  ) {}

  /** Makes the exercise if the server does not have it, and registers the page's lines. */
  async register(): Promise<void> {
    try {
      await this.server.exercises.createExercise(this.isShared ? { name: this.name } : { name: this.name, lease: this.lease }, { timeoutMs: CALL_MS });
      this.registered.clear();
    } catch (error) {
      if (ConnectError.from(error).code !== Code.AlreadyExists) throw error;
      await this.refresh();
      for (const id of this.registered) if (!this.stated.has(id)) this.registered.delete(id);
    }
    this.isThere = true;
    for (const id of this.own.keys()) this.dirty.add(id);
    await this.send();
    await this.refresh();
  }

  /** The server is away: changes wait for `register`. */
  pause(): void {
    this.isThere = false;
  }

  put(lines: Iterable<OwnLine>): void {
    for (const line of lines) {
      this.own.set(line.id, line);
      this.dirty.add(line.id);
      this.gone.delete(line.id);
    }
    this.sendSoon();
  }

  remove(ids: Iterable<bigint>): void {
    for (const id of ids) {
      if (!this.own.delete(id)) continue;
      this.dirty.delete(id);
      this.gone.add(id);
    }
    this.sendSoon();
  }

  /** Asks another fidelity of all lines of the page. */
  ask(asked: Asked): void {
    this.asked = asked;
    for (const id of this.own.keys()) this.dirty.add(id);
    this.sendSoon();
  }

  /** Asks what the server states now; calls meanwhile are answered by one more. */
  async refresh(): Promise<void> {
    this.mustRefresh = true;
    if (this.isRefreshing) return;
    this.isRefreshing = true;
    try {
      while (this.mustRefresh) {
        this.mustRefresh = false;
        const found = await this.server.exercises.getExercise({ name: this.name }, { timeoutMs: CALL_MS });
        this.stated = new Map(found.sightLines.map((line) => [line.id, line]));
        this.epoch = found.epoch;
        this.changed();
      }
    } finally {
      this.isRefreshing = false;
    }
  }

  async end(): Promise<void> {
    await this.server.exercises.deleteExercise({ name: this.name }, { timeoutMs: CALL_MS });
  }

  private get lease() {
    return { owner: this.owner, termS: LEASE_S };
  }

  private sendSoon(): void {
    if (this.isSending || !this.isThere) return;
    this.send().catch(this.failed);
  }

  private async send(): Promise<void> {
    this.isSending = true;
    try {
      while (this.dirty.size + this.gone.size > 0) {
        const removeSightLines = [...this.gone].filter((id) => this.registered.has(id));
        const lines = [...this.dirty].flatMap((id) => this.own.get(id) ?? []);
        this.gone.clear();
        this.dirty.clear();
        if (removeSightLines.length + lines.length === 0) return;
        const putSightLines = lines.map((line) => this.wire(line));
        await this.server.exercises.changeExercise({ name: this.name, removeSightLines, putSightLines, lease: this.lease }, { timeoutMs: CALL_MS });
        for (const id of removeSightLines) this.registered.delete(id);
        for (const { id } of lines) this.registered.add(id);
        void this.refresh().catch(this.failed);
      }
    } finally {
      this.isSending = false;
    }
  }

  private wire(line: OwnLine) {
    const anchor = (end: End) => create(AnchorSchema, {
      anchor: {
        case: "point",
        value: {
          position: { x: end.east, y: end.north, z: end.above },
          frame: CoordinateFrame.SCENE,
          altitude: AltitudeReference.ABOVE_GROUND,
        },
      },
    });
    const { fidelity, distance } = this.asked;
    const obstructionDistanceM = fidelity === Fidelity.OBSTRUCTION ? distance : 0;
    return create(SightLineSchema, { id: line.id, a: anchor(line.a), b: anchor(line.b), fidelity, obstructionDistanceM });
  }
}
