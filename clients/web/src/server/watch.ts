/**
 * The one stream on which all views of the page are watched, for as long as the page lives: when it is lost, it is opened
 * anew, and the views with it, with their last poses and settings.
 */

import { Code, ConnectError, type Server, isAway, said } from "./connection";
import type { WatchedView } from "./view";

/** How long to wait before the next try, in milliseconds: at first and at most. */
const FIRST_WAIT_MS = 250;
const LONGEST_WAIT_MS = 2_000;
/** How often a silent server is asked whether it is there, and how long it may take to say so, in milliseconds. */
const PULSE_MS = 3_000;
const PULSE_PATIENCE_MS = 4_000;

export type Link =
  | { readonly state: "connecting" }
  | { readonly state: "up" }
  | { readonly state: "away"; readonly reason: string }
  | { readonly state: "refused"; readonly reason: string };

export interface WatchHooks {
  /** Called before the views are opened, at first and after each return of the server. */
  prepare(): Promise<void>;
  link(link: Link): void;
}

export class Watch {
  private readonly views = new Map<WatchedView, bigint>();
  private nextId = 1n;
  private watchId: string | undefined;
  private stream = new AbortController();
  private isOver = false;

  constructor(
    private readonly server: Server,
    private readonly hooks: WatchHooks,
  ) {}

  /** Takes a view in; it is opened now, or as soon as the server is there. */
  async add(view: WatchedView): Promise<void> {
    this.views.set(view, 0n);
    await this.reopen(view);
  }

  async remove(view: WatchedView): Promise<void> {
    this.views.delete(view);
    await view.close().catch(() => undefined);
  }

  /** Opens a view anew, for example on another exercise. */
  async reopen(view: WatchedView): Promise<void> {
    await view.close().catch(() => undefined);
    if (this.watchId === undefined || !this.views.has(view)) return;
    const id = this.nextId;
    this.nextId += 1n;
    this.views.set(view, id);
    await view.open(this.server, this.watchId, id);
  }

  /** Watches until `stop`; returns then. */
  async run(): Promise<void> {
    let wait = FIRST_WAIT_MS;
    while (!this.isOver) {
      this.stream = new AbortController();
      try {
        await this.watch(() => {
          wait = FIRST_WAIT_MS;
        });
        this.lost("the stream has ended");
      } catch (error) {
        if (this.isOver) break;
        const { code } = ConnectError.from(error);
        if (code === Code.Unauthenticated || code === Code.PermissionDenied) {
          this.hooks.link({ state: "refused", reason: said(error) });
          return;
        }
        this.lost(said(error));
      }
      await new Promise((wake) => setTimeout(wake, wait));
      wait = Math.min(2 * wait, LONGEST_WAIT_MS);
    }
  }

  stop(): void {
    this.isOver = true;
    this.stream.abort();
  }

  private lost(reason: string): void {
    this.watchId = undefined;
    for (const view of this.views.keys()) view.lose();
    if (!this.isOver) this.hooks.link({ state: "away", reason });
  }

  private async watch(begun: () => void): Promise<void> {
    const { signal } = this.stream;
    const pulse = setInterval(() => void this.feelPulse(), PULSE_MS);
    try {
      for await (const { response } of this.server.scenes.watchViews({}, { signal })) {
        if (response.case === "begun") {
          await this.hooks.prepare();
          this.watchId = response.value.watchId;
          begun();
          this.hooks.link({ state: "up" });
          for (const view of this.views.keys()) void this.reopen(view);
        } else if (response.case === "message" && response.value.message) {
          this.find(response.value.viewId)?.take(response.value.message);
        } else if (response.case === "closed") {
          this.find(response.value.viewId)?.ended(response.value);
        }
      }
    } finally {
      clearInterval(pulse);
    }
  }

  private find(id: bigint): WatchedView | undefined {
    for (const [view, its] of this.views) if (its === id) return view;
    return undefined;
  }

  /** A machine that vanishes says nothing, and what stands between may hold the stream open. */
  private async feelPulse(): Promise<void> {
    const { stream } = this;
    try {
      await this.server.terrain.describeTerrain({}, { timeoutMs: PULSE_PATIENCE_MS });
    } catch (error) {
      if (isAway(error)) stream.abort(error);
    }
  }
}
