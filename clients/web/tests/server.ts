/** A server that is really started, on the ground of the demo. */

import { type ChildProcess, execFileSync, spawn } from "node:child_process";
import { mkdtempSync, rmSync } from "node:fs";
import { createServer } from "node:net";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { fileURLToPath } from "node:url";

const ROOT = fileURLToPath(new URL("../../..", import.meta.url));
const PROGRAM = process.env["SIGHTLINE"] ?? join(ROOT, "target/release/sightline");
const START_MS = 20_000;

export class RunningServer {
  private child: ChildProcess | undefined;

  private constructor(
    private readonly folder: string,
    readonly port: number,
  ) {}

  static async make(): Promise<RunningServer> {
    const folder = mkdtempSync(join(tmpdir(), "sightline-web-"));
    const elevation = join(ROOT, "src/cli/demo/jacksboro.tif");
    execFileSync(PROGRAM, ["ingest", elevation, "-o", join(folder, "hills.sightline"), "--quiet"], { stdio: "ignore" });
    const server = new RunningServer(folder, await freePort());
    await server.start();
    return server;
  }

  get address(): string {
    return `http://127.0.0.1:${this.port}`;
  }

  async start(): Promise<void> {
    const database = join(this.folder, "hills.sightline");
    const child = spawn(PROGRAM, ["serve", database, "--listen", `127.0.0.1:${this.port}`, "--quiet"], { stdio: "ignore" });
    this.child = child;
    const deadline = Date.now() + START_MS;
    while (!(await fetch(`${this.address}/healthz`).then((r) => r.ok, () => false))) {
      if (Date.now() > deadline || child.exitCode !== null) throw new Error(`${PROGRAM} does not serve`);
      await sleep(50);
    }
  }

  /** Ends it as a crash would. */
  async kill(): Promise<void> {
    const { child } = this;
    if (!child || child.exitCode !== null) return;
    const gone = new Promise((done) => child.once("exit", done));
    child.kill("SIGKILL");
    await gone;
  }

  async remove(): Promise<void> {
    await this.kill();
    rmSync(this.folder, { recursive: true, force: true });
  }
}

export const sleep = (ms: number): Promise<void> => new Promise((done) => setTimeout(done, ms));

/** Waits until something holds. */
export async function until(what: string, holds: () => boolean | Promise<boolean>, ms = 15_000): Promise<void> {
  for (const deadline = Date.now() + ms; !(await holds()); await sleep(20)) {
    if (Date.now() > deadline) throw new Error(`in ${ms} ms it did not come to this: ${what}`);
  }
}

function freePort(): Promise<number> {
  return new Promise((done, failed) => {
    const probe = createServer().once("error", failed).listen(0, "127.0.0.1", () => {
      const address = probe.address();
      probe.close(() => done(typeof address === "object" && address ? address.port : 0));
    });
  });
}
