/** Conformance, part 3: a view is resumed after its server was killed. */

import { create } from "@bufbuild/protobuf";
import { afterAll, beforeAll, expect, test } from "vitest";
import { PoseSchema, type ViewSettings, ViewSettingsSchema } from "../src/generated/sightline/v1/scene_pb";
import { connect } from "../src/server/connection";
import { OwnExercise, type OwnLine } from "../src/server/exercise";
import { WatchedView } from "../src/server/view";
import { type Link, Watch } from "../src/server/watch";
import { RunningServer, until } from "./server";

let running: RunningServer;
beforeAll(async () => {
  running = await RunningServer.make();
}, 30_000);
afterAll(() => running.remove());

const settings = (triangles: number): ViewSettings => create(ViewSettingsSchema, {
  projection: { case: "perspective", value: { tanHalfFov: 0.5, nearM: 1 } },
  viewportWidthPx: 800,
  viewportHeightPx: 600,
  target: { case: "triangleBudget", value: { triangles } },
  subscription: { lines: { case: "all", value: {} } },
});
/** Looking down from 5 km, over a place that moves east. */
const pose = (n: number) => create(PoseSchema, {
  eye: { x: 12_000 + 400 * n, y: 15_000, z: 5_000 },
  rotation: { x: 0, y: 0, z: 0, w: 1 },
});
const lines: OwnLine[] = Array.from({ length: 12 }, (_, n) => ({
  id: BigInt(n + 1),
  a: { east: 9_000 + 500 * n, north: 13_000, above: n % 2 ? 2 : 400 },
  b: { east: 15_000 - 300 * n, north: 17_000 - 100 * n, above: 2 },
}));
const state = (view: WatchedView) => ({ hash: view.scene?.mesh.hash, verdicts: view.scene?.verdicts() });

test("a view goes on after its server was killed and started anew", async () => {
  const server = connect(running.address);
  const exercise = new OwnExercise(server, "again", "page-again", false, () => undefined, (error) => expect(error).toBeUndefined());
  const links: Link[] = [];
  const watch = new Watch(server, { prepare: () => exercise.register(), link: (link) => links.push(link) });
  exercise.put(lines);
  const view = new WatchedView({ exercise: "again", pose: pose(0), settings: settings(800) });
  const running_ = watch.run();
  await watch.add(view);
  await until("a first frame with all lines", () => view.scene?.frame !== undefined && view.scene.lines.size === lines.length);
  for (let n = 1; n <= 5; n++) {
    const before = view.frames;
    view.steer(pose(n));
    await until("the frame of a pose", () => view.frames > before);
  }
  await until("the last pose", () => view.scene?.frame?.poseSequence === 5n);
  const before = state(view);
  expect(view.scene?.disagreements()).toEqual([]);
  expect(new Set(before.verdicts?.values()).size).toBe(2);

  await running.kill();
  await until("the lost connection is told", () => links.at(-1)?.state === "away", 5_000);
  expect(state(view), "what was received stays").toEqual(before);

  await running.start();
  await until("the server is back", () => links.at(-1)?.state === "up" && view.frames > 0);
  expect(view.scene?.frame?.baseSequence).toBe(0n);
  expect(view.scene?.verdicts()).toEqual(before.verdicts);
  expect(view.scene?.disagreements()).toEqual([]);

  const fresh = new WatchedView({ exercise: "again", pose: pose(5), settings: settings(800) });
  await watch.add(fresh);
  await until("the first frame of another view", () => fresh.frames > 0);
  expect(fresh.scene?.mesh.hash).toBe(view.scene?.mesh.hash);
  await exercise.end();
  watch.stop();
  await running_;
}, 60_000);

test("a view that makes no sense is refused in words, and one that has lost its mesh gets a snapshot", async () => {
  const server = connect(running.address);
  const watch = new Watch(server, { prepare: () => Promise.resolve(), link: () => undefined });
  const watching = watch.run();
  const reasons: string[] = [];
  await watch.add(new WatchedView({ exercise: "nowhere", pose: pose(0), settings: settings(500) }, { refused: (_, why) => reasons.push(why) }));
  const view = new WatchedView({ exercise: "", pose: pose(0), settings: settings(500) });
  await watch.add(view);
  await until("the refusal and a frame", () => reasons.length === 1 && view.frames > 0);
  expect(reasons[0]).toContain("nowhere");
  view.scene?.mesh.put([{ i: 1, j: 1, z: 5 }]);
  view.steer(pose(3));
  await until("a snapshot", () => view.frames > 1);
  expect(view.scene?.frame?.baseSequence).toBe(0n);
  expect(view.scene?.frame?.poseSequence).toBe(1n);
  watch.stop();
  await watching;
}, 30_000);
