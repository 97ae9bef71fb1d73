/** One view on the page: its picture, its controls and counters, and its own verdict on every sight line. */

import { create } from "@bufbuild/protobuf";
import { Orbit } from "../draw/orbit";
import { ERROR_COLOURS, ERROR_STEPS_M, type Overlay, VOID_COLOUR, type VoidMask } from "../draw/ground";
import { Morph, type Segment } from "../draw/morph";
import { NEAR_M, Picture, TAN_HALF_FOV } from "../draw/picture";
import { type Space, lengthM } from "../draw/space";
import type { Stroke } from "../draw/strokes";
import type { SightLineState } from "../generated/sightline/v1/exercise_pb";
import { PaceSchema, PoseSchema, RegionOfInterestSchema, ViewSettingsSchema } from "../generated/sightline/v1/scene_pb";
import type { Point } from "../mesh/line";
import { type Piece, firstBelow, section } from "../mesh/section";
import type { OwnExercise } from "../server/exercise";
import { WatchedView } from "../server/view";
import { BUDGET_STEPS, GREATEST_BUDGET, LEAST_BUDGET, showCounters } from "./counters";
import { count, fromSlider, make, metres, within } from "./dom";
import type { Errors } from "./errors";
import { listen } from "./gestures";
import { Handles, type Which } from "./handles";
import { COLOURS, type Judged, WORDS, judge, stated } from "./judge";

/** How long posts slide, in milliseconds, and the most lines under which they are kept still. */
const MORPH_MS = 350;
const MAX_STILL_LINES = 300;

/** What the extras of a view offer: a distortion in pixels, frames and bytes a second; 0: not so. */
const AIMS_PX = [0, 0.5, 1, 2, 4, 8, 16];
const RATES_HZ = [0, 30, 10, 5, 2, 1];
const BANDWIDTHS = [0, 100_000, 20_000, 5_000, 2_000];

/** A disc in the scene frame in which distortion counts `weight` times. */
export interface Region {
  readonly east: number;
  readonly north: number;
  readonly radius: number;
  readonly weight: number;
}

/** A click this near to a line selects it, in pixels. */
const NEAR_PX = 7;

/** What a pane asks of the page around it. */
export interface Host {
  readonly space: Space;
  readonly exercise: OwnExercise;
  readonly errors: Errors;
  readonly selected: bigint | undefined;
  readonly showsErrors: boolean;
  readonly region: Region | undefined;
  /** The camera of a pane has moved by hand. */
  moved(pane: Pane): void;
  clicked(at: Point): void;
  hovered(at: Point): void;
  select(id: bigint): void;
  moveEnd(which: Which, at: Point): void;
  nudgeEnd(which: Which, east: number, north: number, up: number): void;
  /** Its verdicts may have changed. */
  judged(): void;
  close(pane: Pane): void;
}

export class Pane {
  readonly element: HTMLElement;
  readonly view: WatchedView;
  readonly picture: Picture;
  judgements = new Map<bigint, Judged>();
  isPlain = false;
  /** Distortion aimed for, in pixels, with at most `budget` triangles; 0: as good as the budget allows. */
  aimPx = 0;

  private readonly canvas: HTMLCanvasElement;
  private readonly handles: Handles;
  private readonly resizing: ResizeObserver;
  private viewport = { width: 1, height: 1 };
  private region: Region | undefined;
  private isOverlaid = false;
  private hasVoids = false;
  private isMorphing = false;
  private morph: Morph | undefined;
  private isMeshNew = false;
  private isUpdateDue = false;
  private isSlideDue = false;
  private judgedHash: bigint | undefined;
  private trouble = "";
  private rates = { bytes: 0, pictures: 0 };
  private pulse = { bytes: 0, drawn: 0, at: performance.now() };

  constructor(
    readonly letter: string,
    readonly colour: string,
    public budget: number,
    readonly orbit: Orbit,
    private readonly host: Host,
    exercise: string,
  ) {
    const template = document.getElementById("pane") as HTMLTemplateElement;
    this.element = within(template.content.cloneNode(true) as DocumentFragment, ".pane");
    this.element.dataset["view"] = letter;
    this.element.style.setProperty("--pane", colour);
    this.element.setAttribute("aria-label", `View ${letter}`);
    within(this.element, "h2").textContent = letter;
    this.canvas = within(this.element, "canvas");
    this.canvas.setAttribute("aria-label", `Terrain in view ${letter}`);
    this.picture = new Picture(this.canvas, host.space, () => this.afterDrawing());
    this.handles = new Handles(within(this.element, ".overlay"), letter, {
      drag: (which, x, y) => {
        const at = this.pick(x, y);
        if (at) host.moveEnd(which, at);
      },
      nudge: (which, right, ahead, up) => {
        const [sin, cos] = [Math.sin(orbit.azimuth), Math.cos(orbit.azimuth)];
        host.nudgeEnd(which, right * cos + ahead * sin, ahead * cos - right * sin, up);
      },
    });
    const wish = { exercise, pose: create(PoseSchema, this.picture.look(orbit, undefined)), settings: this.settings() };
    this.view = new WatchedView(wish, {
      frame: () => {
        this.trouble = "";
        this.isMeshNew = true;
        this.update();
      },
      lines: () => this.update(),
      refused: (_, reason) => {
        this.trouble = reason;
        this.showCounters();
      },
    });
    this.wire();
    this.resizing = new ResizeObserver(() => this.resize());
  }

  /** Once it stands on the page. */
  begin(): void {
    this.resizing.observe(this.canvas);
    this.resize();
  }

  /** Puts the camera where its orbit is. */
  look(): void {
    this.view.steer(create(PoseSchema, this.picture.look(this.orbit, this.view.scene?.mesh)));
  }

  setPlain(isPlain: boolean): void {
    this.isPlain = isPlain;
    this.changeSettings();
    this.update();
  }

  setBudget(triangles: number): void {
    this.budget = Math.round(Math.min(Math.max(triangles, LEAST_BUDGET), GREATEST_BUDGET));
    this.changeSettings();
  }

  set overlay(overlay: Overlay | undefined) {
    this.picture.ground.overlay = overlay;
    this.isOverlaid = overlay !== undefined;
    this.showLegend();
    this.picture.draw();
  }

  set voids(mask: VoidMask | undefined) {
    this.picture.ground.voids = mask;
    this.hasVoids = mask !== undefined;
    this.showLegend();
    this.picture.draw();
  }

  set wireframe(isShown: boolean) {
    this.picture.ground.wire = isShown ? 0.3 : 0;
    this.picture.draw();
  }

  set morphing(isMorphing: boolean) {
    this.isMorphing = isMorphing;
    this.morph = undefined;
    this.isMeshNew = true;
    this.update();
  }

  /** Asks for the page's region of interest, and shows where it is. */
  followRegion(): void {
    const { region, space } = this.host;
    if (JSON.stringify(region) === JSON.stringify(this.region)) return;
    this.region = region;
    const at = region && space.localFromGrid({ x: region.east / space.scale.x, y: region.north / space.scale.y, z: 0 });
    this.picture.ground.ring = at && { x: at.x, y: at.y, radius: region.radius };
    this.changeSettings();
    this.picture.draw();
  }

  /** Judges and draws anew, soon and once. */
  update(): void {
    if (this.isUpdateDue) return;
    this.isUpdateDue = true;
    requestAnimationFrame(() => {
      this.isUpdateDue = false;
      this.judge();
      // Lines may have moved over what slides.
      if (this.isMeshNew || this.morph?.isStill(performance.now()) === false) this.takeMesh();
      this.drawLines();
      this.host.judged();
      this.picture.draw();
    });
  }

  /** Colours by errors, or no longer. */
  recolour(): void {
    this.isMeshNew = true;
    this.update();
    this.showLegend();
  }

  private showLegend(): void {
    const entry = (text: string, colour: string) => {
      const it = make("span", text);
      const patch = make("i");
      patch.style.background = colour;
      it.prepend(patch);
      return it;
    };
    const errors = ERROR_STEPS_M.map((step, n) => entry(n === 0 ? `≤ ${step} m` : `${step} m`, ERROR_COLOURS[n] ?? ""));
    const parts = [
      ...(this.host.showsErrors ? ["height error", ...errors] : []),
      ...(this.isOverlaid ? [entry("seen", "#ffd27f"), entry("not seen", "#2f2b4a")] : []),
      ...(this.hasVoids ? [entry("no data", VOID_COLOUR)] : []),
    ];
    const legend = within(this.element, ".legend");
    legend.hidden = parts.length === 0;
    legend.replaceChildren(...parts);
  }

  sectionOf(a: Point, b: Point): Piece[] {
    return this.view.scene ? section(this.view.scene.mesh, a, b) : [];
  }

  /** A second has passed, or so. */
  tick(): void {
    const now = performance.now();
    const seconds = (now - this.pulse.at) / 1000;
    this.rates = { bytes: (this.view.bytes - this.pulse.bytes) / seconds, pictures: (this.picture.drawn - this.pulse.drawn) / seconds };
    this.showCounters();
    this.pulse = { bytes: this.view.bytes, drawn: this.picture.drawn, at: now };
  }

  dispose(): void {
    this.resizing.disconnect();
    this.picture.dispose();
    this.element.remove();
  }

  // --- what the user does

  private wire(): void {
    const { element, host, orbit } = this;
    for (const mode of element.querySelectorAll<HTMLButtonElement>(".modes button")) {
      mode.addEventListener("click", () => this.setPlain(mode.dataset["mode"] === "plain"));
    }
    const slider = within<HTMLInputElement>(element, ".budget input");
    slider.setAttribute("aria-label", `Triangles of view ${this.letter}`);
    slider.addEventListener("input", () => this.setBudget(niceBudget(fromSlider(Number(slider.value), LEAST_BUDGET, GREATEST_BUDGET, BUDGET_STEPS))));
    this.wireExtras();
    within(element, ".close").addEventListener("click", () => host.close(this));
    listen(this.canvas, {
      turn: (dx, dy) => {
        orbit.turn(dx * 0.006, dy * 0.005);
        host.moved(this);
      },
      pan: (dx, dy) => {
        const step = this.picture.metresPerPixel(orbit);
        orbit.pan(-dx * step, (dy * step) / Math.max(Math.sin(orbit.elevation), 0.25));
        host.moved(this);
      },
      zoom: (factor) => {
        orbit.zoom(factor);
        host.moved(this);
      },
      click: (x, y) => {
        const line = this.lineAt(x, y);
        const at = this.pick(x, y);
        if (line !== undefined && line !== host.selected) host.select(line);
        else if (at) host.clicked(at);
      },
      hover: (x, y) => {
        const at = this.pick(x, y);
        if (at) host.hovered(at);
      },
    });
    this.canvas.addEventListener("keydown", (event) => this.key(event));
  }

  private wireExtras(): void {
    const { element } = this;
    const extras = within<HTMLElement>(element, ".extras");
    const more = within<HTMLButtonElement>(element, ".more");
    more.setAttribute("aria-label", `Target and pace of view ${this.letter}`);
    more.addEventListener("click", () => {
      extras.hidden = !extras.hidden;
      more.setAttribute("aria-expanded", String(!extras.hidden));
    });
    const choice = (selector: string, values: readonly number[], text: (value: number) => string, take: (value: number) => void) => {
      const select = within<HTMLSelectElement>(element, selector);
      select.replaceChildren(...values.map((value) => {
        const option = make("option", text(value));
        option.value = String(value);
        return option;
      }));
      select.addEventListener("change", () => take(Number(select.value)));
      return () => Number(select.value);
    };
    choice(".aim", AIMS_PX, (px) => (px === 0 ? "the whole budget" : `≤ ${px} px`), (px) => {
      this.aimPx = px;
      this.changeSettings();
    });
    const takePace = () => this.view.changePace(create(PaceSchema, { maxRateHz: rate(), maxBytesPerS: BigInt(bandwidth()) }));
    const rate = choice(".rate", RATES_HZ, (hz) => (hz === 0 ? "on every change" : `≤ ${hz} a second`), takePace);
    const bandwidth = choice(".bandwidth", BANDWIDTHS, (bytes) => (bytes === 0 ? "no limit" : `≤ ${bytes / 1000} kB a second`), takePace);
  }

  private key(event: KeyboardEvent): void {
    const { orbit } = this;
    const stride = orbit.distance * 0.04;
    const arrows: Readonly<Record<string, readonly [number, number]>> = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const arrow = arrows[event.key];
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (arrow && event.shiftKey) orbit.pan(arrow[0] * stride, arrow[1] * stride);
    else if (arrow) orbit.turn(arrow[0] * 0.06, arrow[1] * -0.05);
    else if (event.key === "+" || event.key === "=") orbit.zoom(0.87);
    else if (event.key === "-") orbit.zoom(1.15);
    else if (event.key === "Enter") {
      const at = this.pick(this.canvas.clientWidth / 2, this.canvas.clientHeight / 2);
      if (at) this.host.clicked(at);
      return event.preventDefault();
    } else return;
    event.preventDefault();
    this.host.moved(this);
  }

  private pick(x: number, y: number): Point | undefined {
    const mesh = this.view.scene?.mesh;
    return mesh && this.picture.pick(mesh, x, y);
  }

  /** The line that is drawn within a few pixels of a place. */
  private lineAt(x: number, y: number): bigint | undefined {
    let best: { id: bigint; off: number } | undefined;
    for (const [id, { line }] of this.judgements) {
      const [a, b] = this.ends(line).map((end) => end && this.picture.project(end));
      if (!a || !b) continue;
      const [dx, dy] = [b.x - a.x, b.y - a.y];
      const t = Math.min(Math.max(((x - a.x) * dx + (y - a.y) * dy) / (dx * dx + dy * dy || 1), 0), 1);
      const off = Math.hypot(x - a.x - t * dx, y - a.y - t * dy);
      if (off < (best?.off ?? NEAR_PX)) best = { id, off };
    }
    return best?.id;
  }

  // --- what the server hears

  private settings() {
    const { width, height } = this.viewport;
    return create(ViewSettingsSchema, {
      projection: { case: "perspective", value: { tanHalfFov: TAN_HALF_FOV, nearM: NEAR_M } },
      viewportWidthPx: width,
      viewportHeightPx: height,
      target: this.aimPx > 0
        ? { case: "screenError", value: { pixels: this.aimPx, maxTriangles: this.budget } }
        : { case: "triangleBudget", value: { triangles: this.budget } },
      regions: this.region ? [create(RegionOfInterestSchema, { eastM: this.region.east, northM: this.region.north, radiusM: this.region.radius, weight: this.region.weight })] : [],
      subscription: { lines: this.isPlain ? { case: "none", value: {} } : { case: "all", value: {} } },
    });
  }

  private changeSettings(): void {
    this.view.change(this.settings());
    this.showCounters();
  }

  private resize(): void {
    if (this.canvas.clientWidth === 0) return;
    this.viewport = this.picture.resize();
    this.changeSettings();
    this.look();
  }

  // --- what is shown

  /** The lines that this view is about: those of its own epoch, or for a plain mesh those of the exercise. */
  private lines(): Iterable<SightLineState> {
    const scene = this.view.scene;
    if (!this.isPlain && scene && scene.lines.size > 0) return scene.lines.values();
    return this.host.exercise.stated.values();
  }

  private judge(): void {
    const scene = this.view.scene;
    if (!scene?.frame) return;
    // Lines are stated before the frame of their epoch: until it comes, the mesh has not heard of them.
    const isBehind = !this.isPlain && scene.frame.epoch !== scene.epoch;
    if (isBehind && this.judgements.size > 0) return;
    const before = this.judgedHash === scene.mesh.hash ? this.judgements : new Map<bigint, Judged>();
    this.judgedHash = scene.mesh.hash;
    this.judgements = judge(scene.mesh, this.lines(), this.isPlain ? new Map() : scene.unsatisfied, before);
  }

  private takeMesh(): void {
    const mesh = this.view.scene?.mesh;
    if (!mesh) return;
    this.isMeshNew = false;
    const { errors, showsErrors } = this.host;
    this.picture.ground.showsError = showsErrors;
    const lines = this.isMorphing && !showsErrors ? this.still() : undefined;
    if (lines) {
      if (this.morph) this.morph.advance(mesh, lines, performance.now());
      else this.morph = new Morph(mesh, MORPH_MS);
      return this.slide();
    }
    this.morph = undefined;
    this.picture.ground.take(mesh, showsErrors ? (e0, e1) => errors.of(mesh, e0, e1) : undefined);
    if (showsErrors) {
      errors.fetch(mesh).then((isNew) => {
        if (!isNew || !this.host.showsErrors) return;
        this.isMeshNew = true;
        this.update();
      }, () => undefined);
    }
  }

  /** The lines under which nothing may slide; undefined when they are too many. */
  private still(): Segment[] | undefined {
    if (this.judgements.size > MAX_STILL_LINES) return undefined;
    return [...this.judgements.values()].flatMap(({ line: { resolved } }) => (resolved?.a && resolved.b ? [{ a: resolved.a, b: resolved.b }] : []));
  }

  /** Draws posts on their way, picture by picture, until they have come. */
  private slide(): void {
    const { morph } = this;
    if (!morph) return;
    const now = performance.now();
    this.picture.ground.take(morph.drawn(now));
    this.picture.draw();
    if (!morph.isStill(now) && !this.isSlideDue) {
      this.isSlideDue = true;
      requestAnimationFrame(() => {
        this.isSlideDue = false;
        this.slide();
      });
    }
  }

  private ends(line: SightLineState) {
    const { a, b } = line.resolved ?? {};
    const { space } = this.host;
    return [a && space.localFromGrid(a), b && space.localFromGrid(b)] as const;
  }

  private drawLines(): void {
    const { space, selected } = this.host;
    const mesh = this.view.scene?.mesh;
    const halos: Stroke[] = [];
    const strokes: Stroke[] = [];
    for (const [id, { line, onMesh, isWrong, lacking }] of this.judgements) {
      const [from, to] = this.ends(line);
      const { a, b } = line.resolved ?? {};
      if (!mesh || !from || !to || !a || !b || !onMesh) continue;
      const isSelected = id === selected;
      const widthPx = isSelected ? 4 : 2;
      const colour = stated(line) === "UNKNOWN" ? COLOURS.UNKNOWN : COLOURS[onMesh];
      const solid = { colour, opacity: 1, widthPx, isDashed: false };
      if (isWrong || lacking !== undefined) {
        halos.push({ from, to, colour: isWrong && lacking === undefined ? COLOURS.wrong : COLOURS.named, opacity: 0.5, widthPx: widthPx + 7, isDashed: false });
      }
      const t = onMesh === "BLOCKED" ? firstBelow(mesh, a, b) : undefined;
      if (t === undefined) {
        strokes.push({ ...solid, from, to });
        continue;
      }
      const at = from.clone().lerp(to, t);
      strokes.push({ ...solid, from, to: at }, { ...solid, from: at, to, isDashed: true });
      strokes.push({ ...solid, from: at, to: at, widthPx: isSelected ? 12 : 7 });
    }
    this.picture.strokes.take([...halos, ...strokes]);
    this.showVerdict(space);
    this.showCounters();
  }

  private showVerdict(space: Space): void {
    const verdict = within(this.element, ".verdict");
    const judged = this.host.selected === undefined ? undefined : this.judgements.get(this.host.selected);
    const { a, b } = judged?.line.resolved ?? {};
    verdict.hidden = !judged?.onMesh || !a || !b;
    if (!judged?.onMesh || !a || !b) return;
    const { line, onMesh, isWrong, lacking } = judged;
    const isNamed = lacking !== undefined;
    verdict.dataset["kind"] = isNamed ? "named" : isWrong ? "wrong" : onMesh;
    verdict.dataset["line"] = String(line.id);
    verdict.dataset["onMesh"] = onMesh;
    const mesh = make("b", WORDS[onMesh].toUpperCase());
    const rest = isNamed
      ? ` on this mesh, and named: ${lacking > 0 ? `it asks for ${count(lacking)} triangles more than the lines before it` : "no mesh can help it"}`
      : isWrong
        ? ` on this mesh — wrong: it is ${WORDS[stated(line)]}`
        : ` on this mesh, ${stated(line) === "UNKNOWN" ? "unknown ground below" : "as on the terrain"} · ${metres(lengthM(space, a, b))}`;
    verdict.replaceChildren(mesh, rest);
  }

  private afterDrawing(): void {
    const own = this.host.selected === undefined ? undefined : this.host.exercise.own.get(this.host.selected);
    const judged = own && (this.judgements.get(own.id)?.line ?? this.host.exercise.stated.get(own.id));
    const [a, b] = judged ? this.ends(judged) : [undefined, undefined];
    this.handles.place(a && b ? { a, b } : undefined, (at) => this.picture.project(at));
  }

  private showCounters(): void {
    showCounters(this, this.rates, this.trouble);
  }
}

/** Two digits that count. */
function niceBudget(triangles: number): number {
  const unit = 10 ** Math.max(0, Math.floor(Math.log10(triangles)) - 1);
  return Math.round(triangles / unit) * unit;
}
