/** The numbers of one view: in its footer, on its controls, and as attributes for whoever checks the page. */

import { bytes, count, make, toSlider, within } from "./dom";
import type { Pane } from "./pane";

/** The budgets that the slider offers, in triangles. */
export const LEAST_BUDGET = 50;
export const GREATEST_BUDGET = 50_000;
export const BUDGET_STEPS = 120;

/** `rates` are for a second; `trouble` is shown in place of the numbers. */
export function showCounters(pane: Pane, rates: { bytes: number; pictures: number }, trouble: string): void {
  const { element, isPlain } = pane;
  const { scene, frames } = pane.view;
  const triangles = scene?.mesh.triangleCount ?? 0;
  const wrong = [...pane.judgements.values()].filter((j) => j.isWrong && j.lacking === undefined).length;
  const named = isPlain ? 0 : (scene?.unsatisfied.size ?? 0);
  const bound = scene?.frame?.distortionBoundPx ?? NaN;
  const heldBack = scene?.frame?.heldBackMs ?? 0;
  Object.assign(element.dataset, {
    mode: isPlain ? "plain" : "kept", budget: pane.budget, aim: pane.aimPx, bound, heldBack, triangles, frames, epoch: scene?.frame?.epoch ?? 0, wrong, named,
  });
  for (const mode of element.querySelectorAll<HTMLElement>(".modes button")) {
    mode.setAttribute("aria-checked", String((mode.dataset["mode"] === "plain") === isPlain));
  }
  const slider = within<HTMLInputElement>(element, ".budget input");
  if (document.activeElement !== slider) slider.value = String(Math.round(toSlider(pane.budget, LEAST_BUDGET, GREATEST_BUDGET, BUDGET_STEPS)));
  within(element, ".budget output").textContent = `${count(pane.budget)} △`;
  const item = (value: string, unit: string, kind = "", title = "") => {
    const span = make("span", "", kind);
    span.append(make("b", value), ` ${unit}`);
    span.title = title;
    return span;
  };
  within(element, ".counters").replaceChildren(...(trouble ? [make("span", trouble, "blocked")] : [
    item(count(triangles), "triangles"),
    item(Number.isFinite(bound) ? bound.toFixed(bound < 10 ? 2 : 0) : "∞", "px bound", "", "No point of the terrain in the picture is drawn further off than this"),
    item(`${bytes(rates.bytes)}/s`, "", "bytes", "Bytes of messages received in a second"),
    ...(heldBack > 0 ? [item(count(heldBack), "ms held", "held", "How long the last frame was due and held back by the pace")] : []),
    item(count(named), "unsatisfied", named > 0 ? "named" : "", "Lines that the frame names as too dear for the budget"),
    item(count(wrong), "told wrongly", wrong > 0 ? "wrong" : "", "Lines that come out otherwise on this mesh than on the terrain, without being named"),
    item(count(rates.pictures), "pictures/s", "rate", "Drawn only when something changes"),
  ]));
}
