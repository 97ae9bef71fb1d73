/** The two ends of the selected line as buttons over a picture: dragged with a pointer, moved with the keys. */

import type { Vector3 } from "three";
import { make } from "./dom";

export type Which = "a" | "b";

export interface HandleHost {
  /** To a place of the canvas, in CSS pixels. */
  drag(which: Which, x: number, y: number): void;
  /** By steps to the right and ahead as seen, and up. */
  nudge(which: Which, right: number, ahead: number, up: number): void;
}

const KEYS: Readonly<Record<string, readonly [number, number, number]>> = {
  ArrowLeft: [-1, 0, 0], ArrowRight: [1, 0, 0], ArrowUp: [0, 1, 0], ArrowDown: [0, -1, 0], PageUp: [0, 0, 1], PageDown: [0, 0, -1],
};

export class Handles {
  private readonly buttons: Readonly<Record<Which, HTMLButtonElement>>;

  constructor(overlay: HTMLElement, letter: string, host: HandleHost) {
    const button = (which: Which, text: string, name: string) => {
      const it = make("button", text);
      it.type = "button";
      it.dataset["end"] = which;
      it.setAttribute("aria-label", `${name} in view ${letter}: drag, or move with the arrow keys`);
      it.title = name;
      it.hidden = true;
      it.addEventListener("pointerdown", (event) => {
        it.setPointerCapture(event.pointerId);
        event.stopPropagation();
      });
      it.addEventListener("pointermove", (event) => {
        if (!it.hasPointerCapture(event.pointerId)) return;
        const box = overlay.getBoundingClientRect();
        host.drag(which, event.clientX - box.left, event.clientY - box.top);
      });
      it.addEventListener("keydown", (event) => {
        const step = KEYS[event.key];
        if (!step) return;
        event.preventDefault();
        event.stopPropagation();
        const times = event.shiftKey ? 10 : 1;
        host.nudge(which, step[0] * times, step[1] * times, step[2] * times);
      });
      overlay.append(it);
      return it;
    };
    this.buttons = { a: button("a", "O", "Observer"), b: button("b", "T", "Target") };
  }

  /** Puts both where the line's ends are; hides them without a line that can be moved. */
  place(ends: Readonly<Record<Which, Vector3>> | undefined, project: (at: Vector3) => { x: number; y: number } | undefined): void {
    for (const which of ["a", "b"] as const) {
      const at = ends && project(ends[which]);
      const button = this.buttons[which];
      button.hidden = !at;
      if (at) button.style.transform = `translate(${at.x.toFixed(1)}px, ${at.y.toFixed(1)}px)`;
    }
  }
}
