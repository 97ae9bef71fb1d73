/** The page as a whole: its views, its exercise, which line is selected, and what is asked of the server about it. */

import { Orbit } from "../draw/orbit";
import { type Space, lengthM } from "../draw/space";
import type { Overlay, VoidMask } from "../draw/ground";
import { AltitudeReference, CoordinateFrame } from "../generated/sightline/v1/common_pb";
import type { Fidelity, SightLineState } from "../generated/sightline/v1/exercise_pb";
import type { QueryLineOfSightResponse, QueryProfileResponse } from "../generated/sightline/v1/line_of_sight_pb";
import type { Point } from "../mesh/line";
import { CALL_MS, type Server, isAway, said } from "../server/connection";
import { type End, OwnExercise, type OwnLine } from "../server/exercise";
import { type Link, Watch } from "../server/watch";
import { answer } from "./answer";
import { byId, latest } from "./dom";
import { Errors } from "./errors";
import type { Which } from "./handles";
import { COLOURS, stated } from "./judge";
import { viewshed } from "./overlay";
import { type Host, Pane, type Region } from "./pane";
import { plot } from "./profile";
import { type Start, scatter } from "./start";
import { Table } from "./table";
import { findVoids } from "./voids";

const LETTERS = ["A", "B", "C", "D"];
const PANE_COLOURS = ["#7cc0f5", "#c9a7ff", "#ffd166", "#8fe388"];
const BUDGETS = [1_000, 6_000, 300, 20_000];
/** Lines of the page at first, and with each press of a button. */
const SCATTERED = 12;
const OVERLAY_DELAY_MS = 150;

export class App implements Host {
  readonly panes: Pane[] = [];
  readonly errors: Errors;
  readonly watch: Watch;
  readonly exercise: OwnExercise;
  selected: bigint | undefined;
  showsErrors = false;
  above = { a: 2, b: 2 };
  /** The line whose target follows the pointer. */
  placing: bigint | undefined;

  private readonly home: Orbit;
  private readonly table = new Table((id) => this.select(id));
  private isLinked = true;
  private isWired = true;
  private seed = 7;
  private nextId: bigint;
  /** A disc around the selected target in which meshes are finer. */
  private interest: { weight: number; radius: number } | undefined;
  private isMorphing = false;
  private overlay: Overlay | undefined;
  private voids: VoidMask | undefined;
  private overlayRadius: number | undefined;
  private overlayCall = new AbortController();
  private overlayTimer = 0;
  private about: { line: SightLineState; los: QueryLineOfSightResponse; ground: QueryProfileResponse } | undefined;
  private isShowDue = false;
  private hasSelectedFirst = false;

  constructor(
    private readonly server: Server,
    readonly space: Space,
    private readonly start: Start,
    exercise: { name: string; isShared: boolean; owner: string },
    private readonly hooks: { link(link: Link): void; hint(text: string): void; selected(line: OwnLine | undefined): void },
  ) {
    this.errors = new Errors(server, space.scale.z);
    this.nextId = exercise.isShared ? BigInt(Math.floor(Math.random() * 2 ** 40)) << 20n : 1n;
    this.exercise = new OwnExercise(server, exercise.name, exercise.owner, exercise.isShared, () => this.restated(), (error) => this.failed(error));
    this.watch = new Watch(server, {
      prepare: async () => {
        await this.checkTerrain();
        await this.exercise.register();
      },
      link: (link) => {
        if (link.state === "away") this.exercise.pause();
        hooks.link(link);
      },
    });
    const target = space.localFromGrid({ x: start.east / space.scale.x, y: start.north / space.scale.y, z: start.up / space.scale.z });
    const reach = Math.hypot(space.east, space.north);
    this.home = new Orbit(target, 0.72 * start.width, 0.55, 0.5, Math.min(200, reach / 50), 2 * reach);
    if (!exercise.isShared) this.scatter();
  }

  begin(): void {
    this.addPane();
    this.addPane();
    setInterval(() => this.tick(), 1_000);
    findVoids(this.server, this.space).then((voids) => this.showVoids(voids), (error: unknown) => this.failed(error));
  }

  /** A server that comes back with another terrain is another server: the page begins anew. */
  private async checkTerrain(): Promise<void> {
    const { terrain } = await this.server.terrain.describeTerrain({}, { timeoutMs: CALL_MS });
    const [was, is] = [this.space.terrain.version, terrain?.version];
    if (is?.length !== was.length || is.some((byte, n) => byte !== was[n])) location.reload();
  }

  // --- views

  addPane(): void {
    const free = LETTERS.findIndex((letter) => !this.panes.some((pane) => pane.letter === letter));
    if (free < 0) return this.hooks.hint(`${LETTERS.length} views are the most`);
    const orbit = (this.isLinked ? this.panes[0]?.orbit : undefined) ?? this.home;
    const pane = new Pane(LETTERS[free] ?? "", PANE_COLOURS[free] ?? "", BUDGETS[free] ?? 1_000, orbit.clone(), this, this.exercise.name);
    const place = this.panes.findIndex((other) => other.letter > pane.letter);
    this.panes.splice(place < 0 ? this.panes.length : place, 0, pane);
    byId("panes").insertBefore(pane.element, this.panes[this.panes.indexOf(pane) + 1]?.element ?? null);
    pane.wireframe = this.isWired;
    pane.morphing = this.isMorphing;
    pane.overlay = this.overlay;
    pane.voids = this.voids;
    pane.begin();
    if (this.showsErrors) pane.recolour();
    pane.view.wish.leaseOwner = this.exercise.owner;
    pane.followRegion();
    void this.watch.add(pane.view);
    this.judged();
  }

  close(pane: Pane): void {
    if (this.panes.length === 1) return this.hooks.hint("One view stays");
    this.panes.splice(this.panes.indexOf(pane), 1);
    pane.dispose();
    void this.watch.remove(pane.view);
    this.judged();
  }

  moved(pane: Pane): void {
    pane.look();
    if (!this.isLinked) return;
    for (const other of this.panes) {
      if (other === pane) continue;
      other.orbit.follow(pane.orbit);
      other.look();
    }
  }

  goHome(): void {
    for (const pane of this.panes) {
      pane.orbit.follow(this.home);
      pane.look();
    }
  }

  set linked(isLinked: boolean) {
    this.isLinked = isLinked;
    const first = this.panes[0];
    if (isLinked && first) this.moved(first);
  }

  set wireframe(isShown: boolean) {
    this.isWired = isShown;
    for (const pane of this.panes) pane.wireframe = isShown;
  }

  set errorsShown(isShown: boolean) {
    this.showsErrors = isShown;
    for (const pane of this.panes) pane.recolour();
  }

  set morphing(isMorphing: boolean) {
    this.isMorphing = isMorphing;
    for (const pane of this.panes) pane.morphing = isMorphing;
  }

  // --- sight lines

  select(id: bigint | undefined): void {
    this.selected = id;
    if (id !== this.placing) this.placing = undefined;
    this.hooks.selected(id === undefined ? undefined : this.exercise.own.get(id));
    this.followSelected();
    for (const pane of this.panes) pane.update();
    this.judged();
  }

  /** The next line of the table, or the one before. */
  step(by: number): void {
    const ids = [...this.exercise.stated.keys()].sort((p, q) => (p < q ? -1 : 1));
    if (ids.length === 0) return;
    const at = this.selected === undefined ? -1 : ids.indexOf(this.selected);
    this.select(ids[(at + by + ids.length) % ids.length]);
  }

  /** A new line from here, or the end of the one that is being placed. */
  clicked(at: Point): void {
    if (this.placing !== undefined) {
      this.moveEnd("b", at);
      this.placing = undefined;
      return this.hooks.hint("Drag O or T, and watch both views agree. Click the ground for another line.");
    }
    const id = this.nextId;
    this.nextId += 1n;
    this.placing = id;
    this.exercise.put([{ id, a: this.end(at, this.above.a), b: this.end({ ...at, x: at.x + 1e-3 }, this.above.b) }]);
    this.select(id);
    this.hooks.hint("Now the target: move, and click where it stands. Escape stops.");
  }

  hovered(at: Point): void {
    if (this.placing !== undefined) this.moveEnd("b", at);
  }

  /** Stops placing; the line that was begun goes. */
  cancel(): void {
    if (this.placing === undefined) return;
    this.exercise.remove([this.placing]);
    this.placing = undefined;
    this.select(undefined);
    this.hooks.hint("Click the ground to place an observer.");
  }

  scatter(): void {
    this.seed += 1;
    const lines = scatter(this.space, this.start, SCATTERED, this.seed * 2_654_435_761).map((ends): OwnLine => {
      const id = this.nextId;
      this.nextId += 1n;
      return { id, ...ends };
    });
    this.exercise.put(lines);
  }

  deleteSelected(): void {
    const id = this.selected;
    if (id === undefined) return;
    if (!this.exercise.own.has(id)) return this.hooks.hint("That line belongs to somebody else's part of the exercise.");
    if (this.placing === id) this.placing = undefined;
    this.step(1);
    this.exercise.remove([id]);
    if (this.selected === id) this.select(undefined);
  }

  moveEnd(which: Which, at: Point): void {
    this.changeSelected((line) => ({ ...line, [which]: this.end(at, line[which].above) }));
  }

  nudgeEnd(which: Which, east: number, north: number, up: number): void {
    const { scale } = this.space;
    queueMicrotask(() => this.hooks.selected(this.selected === undefined ? undefined : this.exercise.own.get(this.selected)));
    this.changeSelected((line) => {
      const was = line[which];
      const moved = this.space.clamp(was.east + east * scale.x, was.north + north * scale.y);
      return { ...line, [which]: { ...moved, above: Math.max(0, was.above + up) } };
    });
  }

  /** Height of an end of the selected line, and of those to come, in metres over the ground. */
  setAbove(which: Which, metres: number): void {
    this.above = { ...this.above, [which]: metres };
    this.changeSelected((line) => ({ ...line, [which]: { ...line[which], above: metres } }));
  }

  ask(fidelity: Fidelity, distance: number): void {
    this.exercise.ask({ fidelity, distance });
  }

  // --- viewshed

  /** Shows what the selected observer sees within a radius in metres; undefined: nothing. */
  setViewshed(radius: number | undefined): void {
    this.overlayRadius = radius;
    this.followSelected();
  }

  // --- region of interest

  /** Asks for finer meshes around the target of the selected line; undefined: no longer. */
  setInterest(interest: { weight: number; radius: number } | undefined): void {
    this.interest = interest;
    for (const pane of this.panes) pane.followRegion();
  }

  /** The region of interest as it is now, in the scene frame. */
  get region(): Region | undefined {
    const target = this.selected === undefined ? undefined : this.exercise.stated.get(this.selected)?.resolved?.b;
    if (!this.interest || !target) return undefined;
    const { scale } = this.space;
    return { ...this.interest, east: target.x * scale.x, north: target.y * scale.y };
  }

  // --- Host

  judged(): void {
    if (this.isShowDue) return;
    this.isShowDue = true;
    requestAnimationFrame(() => {
      this.isShowDue = false;
      this.table.show(this.exercise.stated, this.panes, this.selected, this.space);
      this.showProfile();
      this.noticeEpoch();
    });
  }

  private changeSelected(change: (line: OwnLine) => OwnLine): void {
    const line = this.selected === undefined ? undefined : this.exercise.own.get(this.selected);
    if (!line) return;
    this.exercise.put([change(line)]);
  }

  private end(at: Point, above: number): End {
    const { scale } = this.space;
    return { ...this.space.clamp(at.x * scale.x, at.y * scale.y), above };
  }

  private restated(): void {
    if (!this.hasSelectedFirst && this.exercise.stated.size > 0) this.selectFirst();
    this.followSelected();
    // A plain view hears of lines from nobody else.
    for (const pane of this.panes) pane.update();
    this.judged();
  }

  /** A line worth looking at: the longest of those that are visible, or of all. */
  private selectFirst(): void {
    this.hasSelectedFirst = true;
    const length = ({ resolved }: SightLineState) => (resolved?.a && resolved.b ? lengthM(this.space, resolved.a, resolved.b) : 0);
    const all = [...this.exercise.stated.values()].sort((p, q) => length(q) - length(p));
    this.select((all.find((line) => stated(line) === "VISIBLE") ?? all[0])?.id);
  }

  private tick(): void {
    for (const pane of this.panes) pane.tick();
    // Others may change a shared exercise; views with sight lines would have told.
    if (this.panes.every((pane) => pane.isPlain)) void this.exercise.refresh().catch(() => undefined);
  }

  /** A view may hear of a new epoch before the page does. */
  private noticeEpoch(): void {
    const newest = this.panes.some(({ view }) => view.isOpen && (view.scene?.epoch ?? 0n) > this.exercise.epoch);
    if (newest) void this.exercise.refresh().catch(() => undefined);
  }

  private failed(error: unknown): void {
    if (!isAway(error)) this.hooks.hint(said(error));
  }

  /** Asks anew about the selected line. */
  private followSelected(): void {
    const line = this.selected === undefined ? undefined : this.exercise.stated.get(this.selected);
    if (!line) {
      this.about = undefined;
      byId("answer").textContent = this.exercise.stated.size === 0 ? "Click the ground to place an observer and a target." : "Select a line.";
      this.judged();
    } else if (this.about?.line !== line) {
      this.enquire(line);
    }
    this.followViewshed();
    for (const pane of this.panes) pane.followRegion();
  }

  private readonly enquire = latest(async (line: SightLineState) => {
    const { a, b } = line.resolved ?? {};
    if (!a || !b) {
      this.about = undefined;
      byId("answer").textContent = "An end has no ground below it: the verdict is unknown.";
      return;
    }
    const end = (position: Point) => ({ position: { x: position.x, y: position.y, z: position.z }, frame: CoordinateFrame.GRID, altitude: AltitudeReference.ABSOLUTE });
    const [los, ground] = await Promise.all([
      this.server.lines.queryLineOfSight({ a: end(a), b: end(b), derive: true }),
      this.server.lines.queryProfile({ frame: CoordinateFrame.GRID, ax: a.x, ay: a.y, bx: b.x, by: b.y }),
    ]);
    if (line.id !== this.selected) return;
    this.about = { line, los, ground };
    byId("answer").replaceChildren(...answer(line, los, this.space));
    this.judged();
  });

  private showProfile(): void {
    const { about, space } = this;
    const { a, b } = about?.line.resolved ?? {};
    if (!about || !a || !b) return plot(undefined);
    const first = about.los.firstFromA;
    plot({
      a, b,
      ground: about.ground,
      meshes: this.panes.map((pane) => ({ name: pane.letter, colour: pane.colour, pieces: pane.sectionOf(a, b) })),
      colour: COLOURS[stated(about.line)],
      obstruction: first ? first.rangeM / (lengthM(space, a, b) || 1) : undefined,
      planLengthM: Math.max(lengthM(space, { ...a, z: 0 }, { ...b, z: 0 }), 1e-6),
      metresPerUnit: space.scale.z,
    });
  }

  private followViewshed(): void {
    clearTimeout(this.overlayTimer);
    this.overlayCall.abort();
    this.overlayCall = new AbortController();
    const line = this.selected === undefined ? undefined : this.exercise.own.get(this.selected);
    const radius = this.overlayRadius;
    if (radius === undefined || !line) return this.showOverlay(undefined);
    const { signal } = this.overlayCall;
    this.overlayTimer = window.setTimeout(() => {
      viewshed(this.server, this.space, line.a, line.b.above, radius, signal).then((found) => this.showOverlay(found), (error: unknown) => {
        if (!signal.aborted) this.failed(error);
      });
    }, OVERLAY_DELAY_MS);
  }

  private showVoids(voids: VoidMask | undefined): void {
    this.voids = voids;
    for (const pane of this.panes) pane.voids = voids;
    byId("panes").dataset["voids"] = String(voids !== undefined);
  }

  private showOverlay(overlay: Overlay | undefined): void {
    this.overlay = overlay;
    for (const pane of this.panes) pane.overlay = overlay;
    byId("panes").dataset["viewshed"] = String(overlay !== undefined);
  }
}
