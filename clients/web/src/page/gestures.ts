/** What mouse, pen and fingers do on a canvas: turn, move, zoom, click. Sizes are in CSS pixels. */

export interface Gestures {
  turn(dx: number, dy: number): void;
  pan(dx: number, dy: number): void;
  zoom(factor: number): void;
  click(x: number, y: number): void;
  hover(x: number, y: number): void;
}

/** A pointer that moves less than this between down and up has clicked. */
const CLICK_PX = 5;

export function listen(canvas: HTMLCanvasElement, to: Gestures): void {
  const down = new Map<number, { x: number; y: number }>();
  let travelled = 0;
  let isPanning = false;
  const place = (event: PointerEvent) => ({ x: event.offsetX, y: event.offsetY });

  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    canvas.focus({ preventScroll: true });
    down.set(event.pointerId, place(event));
    travelled = down.size > 1 ? Infinity : 0;
    isPanning = event.button === 2 || event.button === 1 || event.shiftKey;
    canvas.classList.add("turning");
  });
  canvas.addEventListener("pointermove", (event) => {
    const here = place(event);
    const last = down.get(event.pointerId);
    if (!last) return to.hover(here.x, here.y);
    const [dx, dy] = [here.x - last.x, here.y - last.y];
    const other = [...down].find(([id]) => id !== event.pointerId)?.[1];
    down.set(event.pointerId, here);
    travelled += Math.hypot(dx, dy);
    if (other) {
      const [was, is] = [Math.hypot(last.x - other.x, last.y - other.y), Math.hypot(here.x - other.x, here.y - other.y)];
      if (was > 1 && is > 1) to.zoom(was / is);
      to.pan(dx / 2, dy / 2);
    } else if (travelled >= CLICK_PX) {
      if (isPanning) to.pan(dx, dy);
      else to.turn(dx, dy);
    }
  });
  const up = (event: PointerEvent) => {
    const was = down.delete(event.pointerId);
    if (down.size === 0) canvas.classList.remove("turning");
    if (was && event.type === "pointerup" && event.button === 0 && travelled < CLICK_PX) to.click(event.offsetX, event.offsetY);
  };
  canvas.addEventListener("pointerup", up);
  canvas.addEventListener("pointercancel", up);
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 30 : 1;
    to.zoom(Math.exp(Math.max(-240, Math.min(240, event.deltaY * lines)) / 500));
  }, { passive: false });
}
