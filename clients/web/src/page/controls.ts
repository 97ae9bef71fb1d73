/** Buttons, sliders, switches and keys, wired to the page. */

import { Fidelity } from "../generated/sightline/v1/exercise_pb";
import type { OwnLine } from "../server/exercise";
import { isSoftware } from "../draw/picture";
import type { App } from "./app";
import { byId, fromSlider, metres, toSlider } from "./dom";
import { greatestRadius } from "./overlay";

const FIDELITIES = [
  { fidelity: Fidelity.VERDICT, name: "Verdict", title: "The same answer as on the finest terrain" },
  { fidelity: Fidelity.OBSTRUCTION, name: "Obstruction", title: "Also blocked near the true place" },
  { fidelity: Fidelity.WEDGIE, name: "Wedgie", title: "No error bound that touches the line" },
  { fidelity: Fidelity.PROFILE, name: "Profile", title: "Full detail below the line" },
] as const;
const DISTANCE_M = [10, 2_000] as const;
const LEAST_RADIUS_M = 500;
const INTEREST_RADIUS_M = [100, 20_000] as const;

const GREATEST_HEIGHT_M = 500;

/** Shows the heights of the ends of the selected line. */
export function showHeights(line: OwnLine): void {
  showHeight("observer-height", line.a.above);
  showHeight("target-height", line.b.above);
}

export function wire(app: App): void {
  const click = (id: string, action: () => void) => byId(id).addEventListener("click", action);
  click("new-line", () => newLine(app));
  click("scatter", () => app.scatter());
  click("delete", () => app.deleteSelected());
  click("add-view", () => app.addPane());
  click("help-open", () => byId<HTMLDialogElement>("help").showModal());
  fidelity(app);
  height(app, "observer-height", "a");
  height(app, "target-height", "b");
  check("linked", (on) => (app.linked = on));
  check("wire", (on) => (app.wireframe = on));
  check("show-errors", (on) => (app.errorsShown = on));
  check("morph", (on) => (app.morphing = on));
  // Where the processor draws, or motion is not wanted, posts jump unless somebody says otherwise.
  if (!isSoftware() && !matchMedia("(prefers-reduced-motion: reduce)").matches) byId("morph").click();
  viewshed(app);
  interest(app);
  keys(app);
}

function newLine(app: App): void {
  app.select(undefined);
  byId("hint").textContent = "Click the ground to place the observer.";
  app.panes[0]?.element.querySelector("canvas")?.focus();
}

function check(id: string, set: (on: boolean) => void): void {
  const box = byId<HTMLInputElement>(id);
  box.addEventListener("change", () => set(box.checked));
}

function fidelity(app: App): void {
  const slider = byId<HTMLInputElement>("fidelity");
  const distance = byId<HTMLInputElement>("distance");
  const apply = (tellsServer: boolean) => {
    const choice = FIDELITIES[Number(slider.value)] ?? FIDELITIES[0];
    const within = fromSlider(Number(distance.value), ...DISTANCE_M);
    byId("fidelity-text").textContent = choice.name;
    slider.title = choice.title;
    slider.setAttribute("aria-valuetext", `${choice.name}: ${choice.title}`);
    byId("distance-row").hidden = choice.fidelity !== Fidelity.OBSTRUCTION;
    byId("distance-text").textContent = metres(within);
    if (tellsServer) app.ask(choice.fidelity, within);
  };
  for (const input of [slider, distance]) input.addEventListener("input", () => apply(true));
  apply(false);
}

/** Most of the slider is for low heights: it is a cube root. */
function height(app: App, id: string, which: "a" | "b"): void {
  const slider = byId<HTMLInputElement>(id);
  slider.addEventListener("input", () => {
    const metresUp = Math.round(GREATEST_HEIGHT_M * (Number(slider.value) / 100) ** 3 * 10) / 10;
    byId(`${id}-text`).textContent = `${metres(metresUp)} up`;
    app.setAbove(which, metresUp);
  });
  showHeight(id, app.above[which]);
}

function showHeight(id: string, metresUp: number): void {
  byId<HTMLInputElement>(id).value = String(100 * Math.cbrt(metresUp / GREATEST_HEIGHT_M));
  byId(`${id}-text`).textContent = `${metres(metresUp)} up`;
}

function viewshed(app: App): void {
  const box = byId<HTMLInputElement>("viewshed");
  const slider = byId<HTMLInputElement>("radius");
  const most = Math.min(greatestRadius(app.space), Math.hypot(app.space.east, app.space.north));
  const least = Math.min(LEAST_RADIUS_M, most / 10);
  slider.value = String(Math.round(toSlider(Math.min(8_000, most / 2), least, most)));
  const apply = () => {
    const radius = fromSlider(Number(slider.value), least, most);
    byId("radius-row").hidden = !box.checked;
    byId("radius-text").textContent = metres(radius);
    app.setViewshed(box.checked ? radius : undefined);
  };
  for (const input of [box, slider]) input.addEventListener("input", apply);
  apply();
}

/** Weights are powers of two. */
function interest(app: App): void {
  const box = byId<HTMLInputElement>("interest");
  const weight = byId<HTMLInputElement>("weight");
  const around = byId<HTMLInputElement>("interest-radius");
  const apply = () => {
    const times = 2 ** Number(weight.value);
    const radius = fromSlider(Number(around.value), ...INTEREST_RADIUS_M);
    byId("weight-row").hidden = byId("interest-radius-row").hidden = !box.checked;
    byId("weight-text").textContent = `× ${times}`;
    byId("interest-radius-text").textContent = metres(radius);
    app.setInterest(box.checked ? { weight: times, radius } : undefined);
  };
  for (const input of [box, weight, around]) input.addEventListener("input", apply);
  apply();
}

function keys(app: App): void {
  const toggle = (id: string) => byId<HTMLInputElement>(id).click();
  const actions: Readonly<Record<string, () => void>> = {
    n: () => newLine(app),
    r: () => app.scatter(),
    v: () => app.addPane(),
    w: () => toggle("wire"),
    e: () => toggle("show-errors"),
    s: () => toggle("viewshed"),
    l: () => toggle("linked"),
    m: () => toggle("morph"),
    i: () => toggle("interest"),
    "[": () => app.step(-1),
    "]": () => app.step(1),
    "?": () => byId<HTMLDialogElement>("help").showModal(),
    Delete: () => app.deleteSelected(),
    Backspace: () => app.deleteSelected(),
    Escape: () => app.cancel(),
    Home: () => app.goHome(),
    p: () => {
      const isPlain = !app.panes.some((pane) => pane.isPlain);
      for (const pane of app.panes) pane.setPlain(isPlain);
    },
  };
  addEventListener("keydown", (event) => {
    const isTyping = event.target instanceof HTMLInputElement && event.target.type !== "checkbox" && event.target.type !== "range";
    if (isTyping || event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
    const action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    const isOfSlider = event.target instanceof HTMLInputElement && event.target.type === "range" && event.key === "Home";
    if (!action || isOfSlider) return;
    event.preventDefault();
    action();
  });
}
