/**
 * The page in a real browser, as the server serves it: lines are placed, dragged and judged, budgets changed, the server
 * killed and started anew. After each step what the page claims is compared with what the server says when it is asked
 * directly. Pictures go to `screenshots/`. With a folder in DIST its files are shown in place of those that the server has,
 * so that a change can be tried before the server is built with it.
 */

import { existsSync, mkdirSync, readFileSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { type Browser, type Page, chromium } from "playwright-core";
import { afterAll, beforeAll, expect, test } from "vitest";
import { AltitudeReference, CoordinateFrame, Verdict } from "../src/generated/sightline/v1/common_pb";
import type { Point } from "../src/mesh/line";
import { type Server, connect } from "../src/server/connection";
import { RunningServer, sleep, until } from "../tests/server";

const CHROMIUM = [process.env["CHROMIUM"], "/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"].find((p) => p && existsSync(p));
const PICTURES = fileURLToPath(new URL("../screenshots", import.meta.url));
const VIEWS = ["a", "b"] as const;
/** For one step of a drag or a change of settings, on a machine with other work. */
const PATIENCE_MS = 30_000;

let running: RunningServer;
let browser: Browser;
let page: Page;
let server: Server;
/** Whatever must not be said in the console. */
const complaints: string[] = [];

beforeAll(async () => {
  if (!CHROMIUM) throw new Error("no Chromium: install it, or name it in CHROMIUM");
  mkdirSync(PICTURES, { recursive: true });
  running = await RunningServer.make();
  server = connect(running.address);
  // Sandboxes do not start as root, and there may be no graphics card.
  browser = await chromium.launch({ executablePath: CHROMIUM, args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"] });
  page = await browser.newPage({ viewport: { width: 1440, height: 900 } });
  page.setDefaultTimeout(PATIENCE_MS);
  page.on("pageerror", (error) => complaints.push(error.message));
  page.on("console", (message) => {
    if (/Content Security Policy|WebGL|shader/i.test(message.text()) && message.type() === "error") complaints.push(message.text());
  });
  const dist = process.env["DIST"];
  for (const [path, name] of dist ? [["/", "index.html"], ["/app.js", "app.js"], ["/app.css", "app.css"]] as const : []) {
    await page.route((url) => url.pathname === path, async (route) => {
      await route.fulfill({ response: await route.fetch(), body: readFileSync(`${dist}/${name}`) });
    });
  }
  await page.goto(running.address);
}, 60_000);

afterAll(async () => {
  await browser?.close();
  await running?.remove();
}, 60_000);

type Row = Record<string, string>;

const rows = (): Promise<Row[]> => page.$$eval("#lines-body tr", (all) => all.map((row) => ({ ...(row as HTMLElement).dataset }) as Record<string, string>));
const pane = (letter: string): Promise<Row> => page.$eval(`[data-view=${letter}]`, (it) => ({ ...(it as HTMLElement).dataset }) as Record<string, string>);
const picture = (name: string) => page.screenshot({ path: `${PICTURES}/${name}.png` });
const letter = (view: string) => view.toUpperCase();

/** The page's exercise as the server holds it. */
async function held() {
  const { exercises } = await server.exercises.listExercises({});
  const name = exercises.map((e) => e.name).find((n) => n.startsWith("page-"));
  return name === undefined ? undefined : server.exercises.getExercise({ name });
}

const end = ({ x, y, z }: Point) => ({ position: { x, y, z }, frame: CoordinateFrame.GRID, altitude: AltitudeReference.ABSOLUTE });

/** Tries again until it holds: pictures come when the machine has time for them. */
async function eventually<T>(check: () => Promise<T>): Promise<T> {
  for (const deadline = Date.now() + PATIENCE_MS; ; await sleep(100)) {
    try {
      return await check();
    } catch (error) {
      if (Date.now() > deadline) throw error;
    }
  }
}

/** Compares every verdict that the page shows, and what it counts, with what the server says of the same epoch. */
const compare = (): Promise<Row[]> => eventually(async () => {
  const [now, shown] = [await held(), await rows()];
  const panes = await Promise.all(VIEWS.map(async (view) => ({ view, says: await pane(letter(view)) })));
  expect(shown.length).toBe(now?.sightLines.length);
  const verdicts = new Map<string, string>();
  for (const { id, resolved } of now?.sightLines ?? []) {
    if (!resolved?.a || !resolved.b) throw new Error(`line ${id} has no ends`);
    const { verdict } = await server.lines.queryLineOfSight({ a: end(resolved.a), b: end(resolved.b) });
    verdicts.set(String(id), Verdict[verdict]);
  }
  const isComparable = (row: Row) => row["server"] !== "UNKNOWN";
  for (const row of shown) expect(row["server"], `line ${row["line"]}`).toBe(verdicts.get(row["line"] ?? ""));
  for (const { view, says } of panes) {
    const differing = shown.filter((row) => isComparable(row) && row[view] !== row["server"] && !row[`${view}Named`]);
    if (says["mode"] === "kept") {
      expect(says["epoch"], `epoch of view ${view}`).toBe(String(now?.epoch));
      expect(differing, `view ${view}`).toEqual([]);
    }
    expect(says["wrong"], `wrong in view ${view}`).toBe(String(differing.length));
    expect(Number(says["triangles"])).toBeLessThanOrEqual(Number(says["budget"]));
  }
  return shown;
});

/** Moves the budget of a view with the keys of its slider. */
async function budget(view: string, key: "Home" | "End", steps = 0): Promise<void> {
  await page.focus(`[data-view=${view}] .budget input`);
  await page.keyboard.press(key);
  for (let n = 0; n < steps; n++) await page.keyboard.press(key === "Home" ? "ArrowRight" : "ArrowLeft");
}

test("it begins with two views and lines on which both agree with the server", async () => {
  await page.waitForSelector("[data-view=B]");
  await until("both views have a frame", async () => (await Promise.all(["A", "B"].map(pane))).every((p) => Number(p["frames"]) > 0), PATIENCE_MS);
  expect(await page.textContent("#link-text")).toBe("Connected");
  const shown = await compare();
  expect(shown.length).toBe(12);
  const leases = (await held())?.leases.map(({ holdsExercise, streams, termS }) => ({ holdsExercise, streams, termS }));
  expect(leases, "both views hold what a crash would leave").toEqual([{ holdsExercise: true, streams: 2, termS: 60 }]);
  expect(new Set(shown.map((row) => row["server"])).size).toBe(2);
  await until("a line is chosen and explained", async () => /VISIBLE/.test((await page.textContent("#answer")) ?? ""), PATIENCE_MS);
  await until("both meshes are in the profile", async () => (await page.$$eval("#profile .mesh", (all) => all.length)) === 2, PATIENCE_MS);
  await picture("1-start");
}, 120_000);

test("an observer is dragged behind a ridge, and both views turn the line red", async () => {
  const before = (await page.textContent("[data-view=A] .verdict")) ?? "";
  expect(before).toMatch(/^VISIBLE/);
  const handle = await page.locator("[data-view=A] [data-end=a]").boundingBox();
  if (!handle) throw new Error("no handle");
  const [x, y] = [handle.x + handle.width / 2, handle.y + handle.height / 2];
  await page.mouse.move(x, y);
  await page.mouse.down();
  const verdicts = () => page.$$eval(".pane .verdict", (all) => all.map((it) => (it as HTMLElement).dataset["onMesh"] ?? ""));
  for (let n = 1; n <= 24; n++) {
    await page.mouse.move(x - 6 * n, y + 2 * n);
    await sleep(30);
  }
  await page.mouse.up();
  await until("both say blocked", async () => (await verdicts()).join(" ") === "BLOCKED BLOCKED", PATIENCE_MS);
  await compare();
  await until("the sentence says so, too", async () => /BLOCKED — first obstruction/.test((await page.textContent("#answer")) ?? ""), PATIENCE_MS);
  await picture("2-dragged");
}, 120_000);

test("a click places an observer and its target, and so does the keyboard", async () => {
  const number = (await rows()).length;
  await page.click("#new-line");
  const canvas = await page.locator("[data-view=B] canvas").boundingBox();
  if (!canvas) throw new Error("no canvas");
  await page.mouse.click(canvas.x + 0.4 * canvas.width, canvas.y + 0.75 * canvas.height);
  await page.mouse.move(canvas.x + 0.5 * canvas.width, canvas.y + 0.6 * canvas.height, { steps: 5 });
  await page.mouse.click(canvas.x + 0.6 * canvas.width, canvas.y + 0.55 * canvas.height);
  expect((await compare()).length).toBe(number + 1);
  await page.focus("[data-view=A] canvas");
  await page.keyboard.press("Enter");
  for (let n = 0; n < 3; n++) await page.keyboard.press("Shift+ArrowRight");
  await sleep(300);
  await page.keyboard.press("Enter");
  await page.focus("[data-view=A] [data-end=b]");
  await page.keyboard.press("Shift+ArrowUp");
  expect((await compare()).length).toBe(number + 2);
}, 120_000);

test("a budget too small for the lines is kept, and the lines that it cannot hold are named", async () => {
  await budget("A", "Home");
  await until("view A has few triangles", async () => Number((await pane("A"))["triangles"]) <= 50, PATIENCE_MS);
  await eventually(async () => expect((await compare()).some((row) => row["aNamed"])).toBe(true));
  await picture("3-tight");
  await budget("A", "Home", 60);
  await until("view A has more", async () => Number((await pane("A"))["triangles"]) > 1_000, PATIENCE_MS);
  await until("none is named any more", async () => (await pane("A"))["named"] === "0", PATIENCE_MS);
  await compare();
}, 120_000);

test("a plain mesh of the same budget tells lines wrongly, and the page shows which", async () => {
  await page.keyboard.press("Escape");
  await page.click("#scatter");
  await page.click("#scatter");
  await page.click("[data-view=A] [data-mode=plain]");
  await until("view A is wrong somewhere", async () => Number((await pane("A"))["wrong"]) > 0, PATIENCE_MS);
  const shown = await compare();
  expect(shown.length).toBeGreaterThan(30);
  await page.click("#lines-body tr:has(.wrong)");
  await until("the line that is told wrongly is shown", async () => (await page.getAttribute("[data-view=A] .verdict", "data-kind")) === "wrong", PATIENCE_MS);
  await sleep(500);
  await picture("4-plain");
  await page.click("[data-view=A] [data-mode=kept]");
  await until("view A is right again", async () => (await pane("A"))["wrong"] === "0" && (await pane("A"))["mode"] === "kept", PATIENCE_MS);
  await compare();
}, 120_000);

test("errors and a viewshed are shown, and a fidelity is asked", async () => {
  await page.check("#show-errors");
  expect(await page.getAttribute("#panes", "data-voids")).toBe("false");
  await page.check("#viewshed");
  await until("the viewshed is there", async () => (await page.getAttribute("#panes", "data-viewshed")) === "true", PATIENCE_MS);
  await sleep(700);
  await picture("5-errors-and-viewshed");
  await page.uncheck("#show-errors");
  await sleep(700);
  await picture("5-viewshed");
  await page.uncheck("#viewshed");
  const before = (await held())?.epoch ?? 0n;
  await page.focus("#fidelity");
  await page.keyboard.press("End");
  await until("a new epoch", async () => ((await held())?.epoch ?? 0n) > before, PATIENCE_MS);
  expect((await held())?.sightLines.every((line) => line.fidelity === 3)).toBe(true);
  await page.keyboard.press("Home");
  await until("and back", async () => (await held())?.sightLines.every((line) => line.fidelity === 1) ?? false, PATIENCE_MS);
  await compare();
}, 120_000);

test("a view aims for a distortion, keeps a pace, and is finer around a target", async () => {
  await page.click("[data-view=A] .more");
  await budget("A", "End");
  await until("view A has its budget", async () => Number((await pane("A"))["triangles"]) > 10_000, PATIENCE_MS);
  await page.selectOption("[data-view=A] .aim", "16");
  await until("view A is as good as asked", async () => {
    const { bound, triangles } = await pane("A");
    return Number(bound) <= 16 && Number(bound) > 4 && Number(triangles) < 10_000;
  }, PATIENCE_MS);
  await compare();
  await page.selectOption("[data-view=A] .aim", "0");
  await budget("A", "Home", 60);

  await page.selectOption("[data-view=A] .rate", "2");
  const before = Number((await pane("A"))["frames"]);
  const from = Date.now();
  await page.focus("[data-view=A] canvas");
  do {
    await page.keyboard.press("ArrowLeft");
    await sleep(100);
  } while (Date.now() - from < 2_500 || (await pane("A"))["heldBack"] === "0");
  const [frames, seconds] = [Number((await pane("A"))["frames"]) - before, (Date.now() - from) / 1000];
  expect(frames, `frames in ${seconds} s`).toBeLessThanOrEqual(2 * seconds + 2);
  await picture("6-aim-and-pace");
  await page.selectOption("[data-view=A] .rate", "0");
  await page.click("[data-view=A] .more");

  const bound = async () => Number((await pane("A"))["bound"]);
  await until("view A is at rest", async () => {
    const was = await bound();
    await sleep(400);
    return was === (await bound());
  }, PATIENCE_MS);
  const plain = await bound();
  await page.check("#interest");
  await page.focus("#weight");
  await page.keyboard.press("End");
  // What is spent near the target is missing elsewhere.
  await until("view A is finer around the target", async () => (await bound()) > plain, PATIENCE_MS);
  await page.check("#morph");
  await page.focus("[data-view=A] canvas");
  for (let n = 0; n < 8; n++) await page.keyboard.press("ArrowLeft");
  await compare();
  await picture("7-finer-at-target");
  await page.uncheck("#interest");
  await page.uncheck("#morph");
  await until("and no longer", async () => (await bound()) < 2 * plain, PATIENCE_MS);
}, 120_000);

test("it says that the server is away, keeps what it had, and goes on by itself", async () => {
  const before = await compare();
  await running.kill();
  await page.waitForSelector("#link[data-state=away]", { timeout: 12_000 });
  expect(await page.isVisible("#banner")).toBe(true);
  const shown = async () => (await rows()).map(({ line, server: its, a, b }) => [line, its, a, b]);
  const kept = before.map(({ line, server: its, a, b }) => [line, its, a, b]);
  expect(await shown()).toEqual(kept);
  await picture("8-away");
  await running.start();
  await page.waitForSelector("#link[data-state=up]");
  await until("the views are back", async () => (await Promise.all(["A", "B"].map(pane))).every((p) => Number(p["frames"]) > 0 && p["frames"] !== ""), PATIENCE_MS);
  await compare();
  expect(await shown()).toEqual(kept);
  await picture("9-back");
}, 120_000);

test("it turns smoothly, fits a small screen, and leaves nothing behind", async () => {
  await page.focus("[data-view=A] canvas");
  const from = Date.now();
  const frames = await page.evaluate(async () => {
    const canvas = document.querySelector("[data-view=A] canvas");
    let [drawn, end] = [0, performance.now() + 2_000];
    while (performance.now() < end) {
      canvas?.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowLeft", bubbles: true }));
      await new Promise(requestAnimationFrame);
      drawn += 1;
    }
    return drawn;
  });
  console.log(`${((1000 * frames) / (Date.now() - from)).toFixed(1)} pictures a second of two views, drawn by software`);
  await page.setViewportSize({ width: 1000, height: 760 });
  await page.keyboard.press("v");
  await page.keyboard.press("v");
  await until("four views have frames", async () => (await Promise.all(["A", "B", "C", "D"].map(pane))).every((p) => Number(p["frames"]) > 0), PATIENCE_MS);
  await sleep(500);
  await picture("10-four-views");
  await page.keyboard.press("?");
  await picture("11-help");
  await page.keyboard.press("Escape");
  for (const view of ["C", "D"]) await page.click(`[data-view=${view}] .close`);
  await page.setViewportSize({ width: 390, height: 844 });
  await sleep(500);
  expect(await page.evaluate(() => document.documentElement.scrollWidth - innerWidth)).toBeLessThanOrEqual(0);
  await picture("12-small");
  await page.evaluate(() => scrollTo(0, document.documentElement.scrollHeight));
  await sleep(300);
  await picture("13-small-below");
  await compare();
  await page.goto("about:blank");
  await until("its exercise has ended", async () => (await held()) === undefined, PATIENCE_MS);
  expect(complaints).toEqual([]);
}, 120_000);
