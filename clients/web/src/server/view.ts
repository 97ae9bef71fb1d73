/**
 * One view of a watch: it is opened, steered, acknowledged and resumed here. What the server sends is applied to a `Scene`;
 * a frame that does not fit is passed over and a snapshot asked for.
 *
 * One call is under way at a time and carries the newest pose and settings, so nothing queues on a slow connection.
 */

import { create, toBinary } from "@bufbuild/protobuf";
import {
  OpenViewSchema, type Pace, type Pose, RequestSnapshotSchema, SteerViewSchema, type StreamSceneResponse, StreamSceneResponseSchema,
  type ViewSettings, type WatchedViewClosed,
} from "../generated/sightline/v1/scene_pb";
import { Scene } from "../scene";
import { CALL_MS, type Server, said } from "./connection";

/** What a view asks of the server. */
export interface Wish {
  exercise: string;
  /** Whose lease the view holds; none: nobody's. */
  leaseOwner?: string;
  pose: Pose;
  settings: ViewSettings;
  /** Absent: a frame on every change. */
  pace?: Pace;
}

/** Told after each change; the scene is up to date then. */
export interface ViewListener {
  frame?(view: WatchedView): void;
  lines?(view: WatchedView): void;
  /** The view has ended, or could not be opened; why, in words. */
  refused?(view: WatchedView, reason: string): void;
}

export class WatchedView {
  /** The state after the last frame; it stays readable while the server is away. */
  scene: Scene | undefined;
  /** Bytes of messages received since the page opened the view. */
  bytes = 0;
  /** Frames received since the view was last opened. */
  frames = 0;

  private at: { server: Server; watchId: string; viewId: bigint } | undefined;
  private poseSequence = 0n;
  private hasNewPose = false;
  private hasNewSettings = false;
  private hasNewPace = false;
  private toAcknowledge = false;
  private lostAt: bigint | undefined;
  private isTelling = false;

  constructor(
    readonly wish: Wish,
    private readonly listener: ViewListener = {},
  ) {}

  /** Whether the server holds this view now, as far as is known. */
  get isOpen(): boolean {
    return this.at !== undefined;
  }

  /** Opens the view on a watch, with its last pose and settings; the first frame is a snapshot. */
  async open(server: Server, watchId: string, viewId: bigint): Promise<void> {
    [this.poseSequence, this.frames, this.lostAt] = [0n, 0, undefined];
    this.hasNewPose = this.hasNewSettings = this.hasNewPace = this.toAcknowledge = false;
    this.at = { server, watchId, viewId };
    try {
      const open = create(OpenViewSchema, this.wish);
      await server.scenes.openWatchedView({ watchId, viewId, open }, { timeoutMs: CALL_MS });
    } catch (error) {
      if (this.at?.viewId === viewId) {
        this.at = undefined;
        this.listener.refused?.(this, said(error));
      }
    }
    void this.tell();
  }

  /** The watch is gone, and the view with it. */
  lose(): void {
    this.at = undefined;
  }

  steer(pose: Pose): void {
    this.wish.pose = pose;
    this.hasNewPose = true;
    void this.tell();
  }

  /** Changes camera, target and subscription; frames under way may still be of the old ones. */
  change(settings: ViewSettings): void {
    this.wish.settings = settings;
    this.hasNewSettings = true;
    if (this.scene) this.scene.maxTriangles = Math.max(this.scene.maxTriangles, budget(settings));
    void this.tell();
  }

  /** Changes how often frames come and how many bytes. */
  changePace(pace: Pace): void {
    this.wish.pace = pace;
    this.hasNewPace = true;
    void this.tell();
  }

  async close(): Promise<void> {
    const at = this.at;
    this.at = undefined;
    if (at) await at.server.scenes.closeWatchedView({ watchId: at.watchId, viewId: at.viewId }, { timeoutMs: CALL_MS });
  }

  /** Takes what the watch carries for this view. */
  take(message: StreamSceneResponse): void {
    this.bytes += toBinary(StreamSceneResponseSchema, message).length;
    const { response } = message;
    if (response.case === "opened") {
      this.scene = new Scene(response.value, budget(this.wish.settings), this.wish.exercise !== "", this.scene);
      return;
    }
    if (!this.scene) return;
    if (response.case === "exercise") {
      this.scene.apply(message);
      this.listener.lines?.(this);
    } else if (response.case === "frame") {
      if (this.lostAt !== undefined && response.value.baseSequence !== 0n) return;
      try {
        this.scene.apply(message);
      } catch (error) {
        console.warn(`frame ${response.value.sequence} is passed over: ${said(error)}`);
        this.lostAt = response.value.sequence;
        void this.tell();
        return;
      }
      this.lostAt = undefined;
      this.toAcknowledge = true;
      this.frames += 1;
      void this.tell();
      this.listener.frame?.(this);
    }
  }

  ended(closed: WatchedViewClosed): void {
    if (this.at?.viewId !== closed.viewId) return;
    this.at = undefined;
    if (closed.code !== 0) this.listener.refused?.(this, closed.reason);
  }

  /** Sends what is new, until nothing is. */
  private async tell(): Promise<void> {
    if (this.isTelling) return;
    this.isTelling = true;
    let asked: bigint | undefined;
    try {
      while (this.at && this.frames + (this.lostAt ? 1 : 0) > 0) {
        const { server, watchId, viewId } = this.at;
        if (this.lostAt !== undefined && this.lostAt !== asked) {
          asked = this.lostAt;
          const snapshot = create(RequestSnapshotSchema, { receivedSequence: asked });
          await server.scenes.tellWatchedView({ watchId, viewId, request: { case: "snapshot", value: snapshot } }, { timeoutMs: CALL_MS });
          continue;
        }
        if (!this.hasNewPose && !this.hasNewSettings && !this.hasNewPace && !this.toAcknowledge) return;
        await server.scenes.tellWatchedView({ watchId, viewId, request: { case: "steer", value: this.steering() } }, { timeoutMs: CALL_MS });
      }
    } catch (error) {
      // The watch's stream tells if the server has gone; a refusal ends the view, which it tells, too.
      console.warn(`a view could not be told: ${said(error)}`);
    } finally {
      this.isTelling = false;
    }
  }

  private steering() {
    const steer = create(SteerViewSchema, { appliedSequence: this.scene?.frame?.sequence ?? 0n });
    if (this.hasNewPose) {
      this.poseSequence += 1n;
      steer.pose = this.wish.pose;
    }
    if (this.hasNewSettings) steer.settings = this.wish.settings;
    if (this.hasNewPace && this.wish.pace) steer.pace = this.wish.pace;
    steer.poseSequence = this.poseSequence;
    this.hasNewPose = this.hasNewSettings = this.hasNewPace = this.toAcknowledge = false;
    return steer;
  }
}

/** The greatest number of triangles that settings ask for. */
export function budget(settings: ViewSettings): number {
  const { target } = settings;
  if (target.case === "triangleBudget") return target.value.triangles;
  return target.value?.maxTriangles ?? 0;
}
