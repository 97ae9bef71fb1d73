/** The entry: connects, says how the connection stands, and starts the page once the terrain is known. */

import { Space } from "./draw/space";
import { App } from "./page/app";
import { showHeights, wire } from "./page/controls";
import { byId, count, make, metres } from "./page/dom";
import { findStart } from "./page/start";
import { CALL_MS, Code, ConnectError, type Server, connect, leave, said } from "./server/connection";
import type { Link } from "./server/watch";
import type { TerrainDescription } from "./generated/sightline/v1/terrain_pb";

const RETRY_MS = 1_500;
/** How long the page says that the server is back, in milliseconds. */
const BACK_MS = 3_000;
const TOKEN = "sightline-token";

const server = connect(location.origin, () => sessionStorage.getItem(TOKEN) ?? "");
let wasAway = false;

function show(link: Link): void {
  const words = { connecting: "Connecting", up: "Connected", away: "Server away", refused: "Refused" } as const;
  byId("link").dataset["state"] = link.state;
  byId("link-text").textContent = words[link.state];
  const banner = byId("banner");
  if (link.state === "up") {
    if (!wasAway) return;
    wasAway = false;
    banner.dataset["kind"] = "back";
    banner.textContent = "The server is back: lines and views are as you left them.";
    setTimeout(() => {
      if (!wasAway) banner.hidden = true;
    }, BACK_MS);
  } else if (link.state === "away") {
    wasAway = true;
    banner.dataset["kind"] = "away";
    banner.textContent = `The server is away (${link.reason}). What you see is the last that it sent; the page goes on by itself when it is back.`;
    banner.hidden = false;
  } else if (link.state === "refused") {
    void askToken(link.reason).then(() => location.reload());
  }
}

async function askToken(reason: string): Promise<void> {
  const dialog = byId<HTMLDialogElement>("token");
  byId("token-reason").textContent = reason;
  dialog.showModal();
  await new Promise((done) => dialog.addEventListener("close", done, { once: true }));
  sessionStorage.setItem(TOKEN, byId<HTMLInputElement>("token-text").value);
}

/** Calls until a server answers. */
async function insist<T>(call: () => Promise<T>): Promise<T> {
  for (;;) {
    try {
      return await call();
    } catch (error) {
      const { code } = ConnectError.from(error);
      if (code === Code.Unauthenticated || code === Code.PermissionDenied) await askToken(said(error));
      else {
        show({ state: "away", reason: said(error) });
        await new Promise((wake) => setTimeout(wake, RETRY_MS));
      }
    }
  }
}

/** The exercise of the address, or one of this page's own; and a choice of those that there are. */
async function chooseExercise(of: Server): Promise<{ name: string; isShared: boolean; owner: string }> {
  const wanted = new URLSearchParams(location.search).get("exercise");
  const { exercises } = await of.exercises.listExercises({}, { timeoutMs: CALL_MS });
  const select = byId<HTMLSelectElement>("exercise");
  const option = (value: string, text: string) => {
    const it = make("option", text);
    it.value = value;
    it.selected = value === (wanted ?? "");
    return it;
  };
  select.replaceChildren(option("", "own"), ...exercises.filter((e) => !e.name.startsWith("page-") || e.name === wanted).map((e) => option(e.name, `${e.name} (${count(e.sightLines)} lines)`)));
  select.addEventListener("change", () => {
    location.search = select.value ? `?exercise=${encodeURIComponent(select.value)}` : "";
  });
  const owner = `page-${crypto.getRandomValues(new Uint32Array(2)).join("-")}`;
  if (wanted && exercises.some((e) => e.name === wanted)) return { name: wanted, isShared: true, owner };
  return { name: owner, isShared: false, owner };
}

/** What share of the posts nobody knows. */
function noData({ nx, ny, voidPosts }: TerrainDescription): string {
  const percent = (Number(voidPosts) / (nx * ny)) * 100;
  return percent === 0 ? "" : ` · ${percent < 0.1 ? "< 0.1" : percent.toFixed(1)} % no data`;
}

async function main(): Promise<void> {
  const { terrain } = await insist(() => server.terrain.describeTerrain({}, { timeoutMs: CALL_MS }));
  if (!terrain) throw new Error("the server describes no terrain");
  const space = new Space(terrain);
  const [low, high] = [terrain.minHeight, terrain.maxHeight].map((z) => count(z * space.scale.z));
  byId("terrain").textContent = `${count(terrain.nx)} × ${count(terrain.ny)} posts · ${metres(space.east)} × ${metres(space.north)} · ${low} to ${high} m${noData(terrain)}`;
  const start = await insist(() => findStart(server, space));
  const exercise = await insist(() => chooseExercise(server));
  const hint = (text: string) => (byId("hint").textContent = text);
  const app = new App(server, space, start, exercise, { link: show, hint, selected: (line) => line && showHeights(line) });
  wire(app);
  app.begin();
  hint("Click the ground to place an observer; drag to look around.");
  addEventListener("resize", () => app.judged());
  addEventListener("pagehide", () => {
    leave();
    if (exercise.isShared) app.exercise.remove([...app.exercise.own.keys()]);
    else void app.exercise.end();
  });
  await app.watch.run();
}

main().catch((error: unknown) => {
  byId("banner").textContent = `The viewer cannot go on: ${said(error)}`;
  byId("banner").hidden = false;
  console.error(error);
});
