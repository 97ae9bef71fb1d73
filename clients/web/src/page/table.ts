/** All sight lines: the exact verdict of the server, and what each view makes of it. */

import { type Space, lengthM } from "../draw/space";
import type { Segment } from "../generated/sightline/v1/common_pb";
import type { SightLineState } from "../generated/sightline/v1/exercise_pb";
import { byId, count, make, metres } from "./dom";
import { WORDS, stated } from "./judge";
import type { Pane } from "./pane";

const MAX_ROWS = 200;

export class Table {
  private readonly body = byId<HTMLTableSectionElement>("lines-body");
  private shownSelected: bigint | undefined;

  constructor(private readonly select: (id: bigint) => void) {}

  show(lines: ReadonlyMap<bigint, SightLineState>, panes: readonly Pane[], selected: bigint | undefined, space: Space): void {
    byId("lines-head").replaceChildren(...["Line", "Length", "Server", ...panes.map((pane) => `View ${pane.letter}`)].map((text) => make("th", text)));
    const ids = [...lines.keys()].sort((p, q) => (p < q ? -1 : 1));
    this.body.replaceChildren(...ids.slice(0, MAX_ROWS).map((id) => this.row(id, lines.get(id) as SightLineState, panes, selected, space)));
    byId("lines-more").textContent = ids.length > MAX_ROWS ? `and ${count(ids.length - MAX_ROWS)} more` : "";
    if (selected !== this.shownSelected) this.reveal();
    this.shownSelected = selected;
  }

  /** Scrolls the list, and nothing around it, to the selected line. */
  private reveal(): void {
    const row = this.body.querySelector<HTMLElement>("[aria-selected=true]");
    const box = this.body.closest<HTMLElement>(".lines");
    if (!row || !box) return;
    const [top, bottom] = [row.offsetTop - 2 * row.offsetHeight, row.offsetTop + row.offsetHeight];
    if (top < box.scrollTop || bottom > box.scrollTop + box.clientHeight) box.scrollTop = top;
  }

  private row(id: bigint, line: SightLineState, panes: readonly Pane[], selected: bigint | undefined, space: Space): HTMLElement {
    const row = make("tr");
    const { a, b } = line.resolved ?? {};
    const verdict = stated(line);
    row.dataset["line"] = String(id);
    row.dataset["server"] = verdict;
    row.setAttribute("aria-selected", String(id === selected));
    row.append(make("td", String(id)), make("td", a && b ? metres(lengthM(space, a, b)) : "–"), make("td", WORDS[verdict], verdict.toLowerCase()));
    for (const pane of panes) {
      const judged = pane.judgements.get(id);
      // A line that has moved since waits for the view's frame of its epoch.
      const onMesh = judged && isSame(judged.line.resolved, line.resolved) ? judged.onMesh : undefined;
      const isNamed = judged?.lacking !== undefined;
      row.dataset[pane.letter.toLowerCase()] = onMesh ?? "";
      if (isNamed) row.dataset[`${pane.letter.toLowerCase()}Named`] = "true";
      const isWrong = onMesh !== undefined && judged?.isWrong === true;
      const text = onMesh ? WORDS[onMesh] : a && b ? "…" : "–";
      const kind = isNamed ? "named" : isWrong ? "wrong" : (onMesh ?? "unknown").toLowerCase();
      row.append(make("td", isNamed ? `${text} · named` : isWrong ? `${text} ✗` : text, kind));
    }
    row.addEventListener("click", () => this.select(id));
    return row;
  }
}

function isSame(p: Segment | undefined, q: Segment | undefined): boolean {
  const numbers = (s: Segment | undefined) => [s?.a?.x, s?.a?.y, s?.a?.z, s?.b?.x, s?.b?.y, s?.b?.z];
  return numbers(p).every((n, k) => n === numbers(q)[k]);
}
