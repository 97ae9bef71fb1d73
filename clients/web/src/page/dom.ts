/** Elements that must be there, and text as people read it. */

export function byId<T extends Element = HTMLElement>(id: string): T {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no #${id}`);
  return found as unknown as T;
}

export function within<T extends Element = HTMLElement>(root: ParentNode, selector: string): T {
  const found = root.querySelector<T>(selector);
  if (!found) throw new Error(`no ${selector}`);
  return found;
}

export function make<K extends keyof HTMLElementTagNameMap>(tag: K, text = "", kind = ""): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  if (text) element.textContent = text;
  if (kind) element.className = kind;
  return element;
}

const whole = new Intl.NumberFormat("en", { maximumFractionDigits: 0 });

export const count = (n: number): string => whole.format(n);

/** A length with a unit and three digits that count. */
export function metres(m: number): string {
  if (m === 0) return "0 m";
  if (Math.abs(m) >= 10_000) return `${(m / 1000).toFixed(1)} km`;
  if (Math.abs(m) >= 1_000) return `${(m / 1000).toFixed(2)} km`;
  return `${m.toFixed(Math.abs(m) < 10 ? 1 : 0)} m`;
}

export function bytes(n: number): string {
  return n < 1000 ? `${count(n)} B` : n < 1e6 ? `${(n / 1000).toFixed(1)} kB` : `${(n / 1e6).toFixed(2)} MB`;
}

/** A slider of 0 to 100 that runs from `low` to `high` in equal ratios. */
export const fromSlider = (value: number, low: number, high: number, steps = 100): number => low * (high / low) ** (value / steps);
export const toSlider = (value: number, low: number, high: number, steps = 100): number => (steps * Math.log(value / low)) / Math.log(high / low);

/**
 * Runs an asynchronous task for the newest argument only: while one is under way, later ones replace each other.
 */
export function latest<T>(task: (argument: T) => Promise<void>): (argument: T) => void {
  let waiting: { argument: T } | undefined;
  let isRunning = false;
  return (argument) => {
    waiting = { argument };
    if (isRunning) return;
    isRunning = true;
    void (async () => {
      while (waiting) {
        const next = waiting.argument;
        waiting = undefined;
        await task(next).catch((error: unknown) => console.warn(error));
      }
      isRunning = false;
    })();
  };
}
