/** Conformance, part 2: recorded sessions; hash, lines, verdicts and named lines after every frame. */

import { readdirSync } from "node:fs";
import { fromBinary } from "@bufbuild/protobuf";
import { expect, test } from "vitest";
import { type StreamSceneResponse, StreamSceneResponseSchema } from "../src/generated/sightline/v1/scene_pb";
import { PayloadError } from "../src/mesh/bits";
import { Scene, SceneError } from "../src/scene";
import { file, hex, listed } from "./support";

interface Line {
  message: string;
  held?: Record<string, unknown>;
  max_triangles?: number;
  lines_expected?: boolean;
}

const SESSIONS = readdirSync(new URL("../../conformance", import.meta.url)).filter((name) => name.endsWith(".jsonl"));

/** A scene after its opening, and the messages that follow, with what must be held after them. */
function read(name: string, before?: Scene): { scene: Scene; messages: { message: StreamSceneResponse; wanted: Line["held"] }[] } {
  const [head, opening, ...rest] = file(`clients/conformance/${name}`).trim().split("\n").map((line) => JSON.parse(line) as Line);
  const parse = (line: Line | undefined) => fromBinary(StreamSceneResponseSchema, hex(line?.message ?? ""));
  const opened = parse(opening).response;
  if (opened.case !== "opened") throw new Error("line 2 is no opening");
  const scene = new Scene(opened.value, head?.max_triangles ?? 0, head?.lines_expected ?? false, before);
  return { scene, messages: rest.map((line) => ({ message: parse(line), wanted: line.held })) };
}

function held(scene: Scene): Record<string, unknown> {
  const verdicts = scene.verdicts();
  const ascending = (p: bigint, q: bigint) => (p < q ? -1 : 1);
  const named = [...scene.unsatisfied.keys()].sort(ascending);
  return {
    sequence: Number(scene.frame?.sequence),
    epoch: Number(scene.epoch),
    triangles: scene.mesh.triangleCount,
    hash: scene.mesh.hash.toString(16).padStart(16, "0"),
    lines: [...verdicts.keys()].map(String),
    verdicts: [...verdicts.values()].map((verdict) => verdict[0]).join(""),
    unsatisfied: named.map(String),
    lacking: named.map((id) => scene.unsatisfied.get(id)),
    off_ground: [...scene.offGround].sort(ascending).map(String),
  };
}

test("there are sessions", () => expect(SESSIONS.length).toBeGreaterThanOrEqual(2));

test.each(SESSIONS)("every frame of %s", (name) => {
  const { scene, messages } = read(name);
  let frames = 0;
  for (const { message, wanted } of messages) {
    expect(scene.apply(message) === "frame").toBe(wanted !== undefined);
    if (!wanted) continue;
    expect(held(scene)).toEqual(wanted);
    expect(scene.disagreements()).toEqual([]);
    frames += 1;
  }
  expect(frames).toBeGreaterThan(10);
});

test.each(SESSIONS)("a frame of %s that is left out is noticed until the next snapshot", (name) => {
  const { scene, messages } = read(name);
  let [isLost, refused, recovered] = [false, 0, 0];
  messages.forEach(({ message, wanted }, n) => {
    if (n === 4) {
      expect(message.response.case).toBe("frame");
      isLost = true;
      return;
    }
    const isSnapshot = message.response.case === "frame" && message.response.value.baseSequence === 0n;
    if (isLost && wanted && !isSnapshot) {
      const before = listed(scene.mesh);
      expect(() => scene.apply(message)).toThrow(SceneError);
      expect(listed(scene.mesh)).toEqual(before);
      refused += 1;
      return;
    }
    scene.apply(message);
    if (isSnapshot && isLost) [isLost, recovered] = [false, recovered + 1];
    if (wanted) expect(held(scene)).toEqual(wanted);
  });
  expect(refused).toBeGreaterThan(0);
  expect(recovered).toBeGreaterThan(0);
});

test.each(SESSIONS)("the view of %s that is opened anew keeps its mesh until a snapshot", (name) => {
  const first = read(name);
  for (const { message } of first.messages) first.scene.apply(message);
  const before = [first.scene.mesh.hash, listed(first.scene.mesh)];
  const { scene, messages } = read(name, first.scene);
  expect([scene.mesh.hash, listed(scene.mesh)]).toEqual(before);
  expect(scene.lines.size).toBe(0);
  const isDelta = ({ message: { response } }: (typeof messages)[number]) => response.case === "frame" && response.value.baseSequence !== 0n;
  const delta = messages.find(isDelta)?.message;
  if (!delta) throw new Error("a session without a delta");
  expect(() => scene.apply(delta)).toThrow(SceneError);
  expect([scene.mesh.hash, listed(scene.mesh)]).toEqual(before);
  for (const { message, wanted } of messages) {
    scene.apply(message);
    if (wanted) expect(held(scene)).toEqual(wanted);
  }
});

test("a frame with another hash or count is refused and leaves the mesh as it was", () => {
  const { scene, messages } = read(SESSIONS[0] ?? "");
  let checked = 0;
  for (const { message } of messages.slice(0, 6)) {
    const { response } = message;
    if (response.case === "frame") {
      const before = [scene.mesh.hash, scene.mesh.triangleCount, listed(scene.mesh)];
      const right = response.value;
      for (const wrong of [{ meshHash: right.meshHash - 1n }, { triangleCount: right.triangleCount - 1 }]) {
        const other = { ...message, response: { case: "frame" as const, value: { ...right, ...wrong } } };
        expect(() => scene.apply(other)).toThrow(PayloadError);
        expect([scene.mesh.hash, scene.mesh.triangleCount, listed(scene.mesh)]).toEqual(before);
        checked += 1;
      }
    }
    scene.apply(message);
  }
  expect(checked).toBeGreaterThan(2);
});
