/** The canvas of one view: ground and strokes from its camera, drawn when something has changed. */

import { PerspectiveCamera, Scene as Stage, Vector3, WebGLRenderer } from "three";
import { type Point } from "../mesh/line";
import type { Mesh } from "../mesh/mesh";
import { firstBelow, heightAt } from "../mesh/section";
import { Ground } from "./ground";
import type { Orbit } from "./orbit";
import type { Space } from "./space";
import { Strokes } from "./strokes";

export const TAN_HALF_FOV = 0.42;
/** Near plane that the server is told, in metres. */
export const NEAR_M = 1;
/** Least height of the eye over this view's own ground, in metres. */
const EYE_OVER_GROUND_M = 5;

export class Picture {
  readonly ground: Ground;
  readonly strokes = new Strokes();
  /** Pictures drawn so far. */
  drawn = 0;

  private readonly renderer: WebGLRenderer;
  private readonly stage = new Stage();
  private readonly camera = new PerspectiveCamera((2 * Math.atan(TAN_HALF_FOV) * 180) / Math.PI);
  private requested = 0;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly space: Space,
    private readonly after: () => void,
  ) {
    this.renderer = new WebGLRenderer({ canvas, antialias: !isSoftware(), alpha: true });
    this.renderer.setClearAlpha(0);
    this.ground = new Ground(space);
    this.stage.add(this.ground.drawn, this.strokes.drawn);
    canvas.addEventListener("webglcontextrestored", () => this.draw());
  }

  /** Fits the canvas to its box; its size in pixels of the screen. */
  resize(): { width: number; height: number } {
    const { clientWidth, clientHeight } = this.canvas;
    const [width, height] = [Math.max(clientWidth, 1), Math.max(clientHeight, 1)];
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.strokes.viewport = [width, height];
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    // A canvas that has changed its size is empty, and shown so if it is not drawn at once.
    this.render();
    return { width: this.canvas.width, height: this.canvas.height };
  }

  /** Puts the camera where an orbit is, but not under the ground; answers the pose in the scene frame. */
  look(orbit: Orbit, mesh: Mesh | undefined) {
    const { eye, rotation } = orbit.pose();
    const below = this.space.gridFromLocal(eye);
    const ground = mesh && heightAt(mesh, below.x, below.y);
    if (ground !== undefined) {
      const floor = this.space.localFromGrid({ x: below.x, y: below.y, z: ground }).z + EYE_OVER_GROUND_M;
      eye.z = Math.max(eye.z, floor);
    }
    this.camera.position.copy(eye);
    this.camera.quaternion.copy(rotation);
    this.camera.near = Math.max(NEAR_M, orbit.distance / 300);
    this.camera.far = orbit.distance * 3 + 1.5 * Math.hypot(this.space.east, this.space.north);
    this.ground.hazeAt = this.camera.far * 0.55;
    // At once: what is pointed at before the next picture is pointed at from here.
    this.camera.updateProjectionMatrix();
    this.camera.updateMatrixWorld();
    this.draw();
    const { x, y, z, w } = rotation;
    return { eye: this.space.sceneFromLocal(eye), rotation: { x, y, z, w } };
  }

  /** Draws soon, once, however often it is asked. */
  draw(): void {
    if (!this.requested) this.requested = requestAnimationFrame(() => this.render());
  }

  private render(): void {
    cancelAnimationFrame(this.requested);
    this.requested = 0;
    this.renderer.render(this.stage, this.camera);
    this.drawn += 1;
    this.after();
  }

  /** Where a place of the local frame is on the canvas, in CSS pixels; undefined when behind the eye. */
  project(at: Vector3): { x: number; y: number } | undefined {
    const seen = at.clone().project(this.camera);
    if (seen.z > 1 || seen.z < -1) return undefined;
    return { x: ((seen.x + 1) / 2) * this.canvas.clientWidth, y: ((1 - seen.y) / 2) * this.canvas.clientHeight };
  }

  /** The ground under a place of the canvas, in CSS pixels, in the grid frame. */
  pick(mesh: Mesh, x: number, y: number): Point | undefined {
    const ndc = new Vector3((2 * x) / this.canvas.clientWidth - 1, 1 - (2 * y) / this.canvas.clientHeight, 0.5);
    const eye = this.camera.position;
    const ray = ndc.unproject(this.camera).sub(eye).normalize();
    const from = this.space.gridFromLocal(eye);
    const to = this.space.gridFromLocal(eye.clone().addScaledVector(ray, this.camera.far));
    const t = firstBelow(mesh, from, to);
    if (t === undefined) return undefined;
    return { x: from.x + t * (to.x - from.x), y: from.y + t * (to.y - from.y), z: from.z + t * (to.z - from.z) };
  }

  /** Metres of the plan that a pixel at the orbit's target is wide. */
  metresPerPixel(orbit: Orbit): number {
    return (2 * TAN_HALF_FOV * orbit.distance) / Math.max(this.canvas.clientHeight, 1);
  }

  dispose(): void {
    cancelAnimationFrame(this.requested);
    this.ground.dispose();
    this.strokes.dispose();
    this.renderer.dispose();
    // Browsers allow a few contexts only, and collect them late.
    this.renderer.forceContextLoss();
  }
}

let software: boolean | undefined;

/** Whether the processor draws, as far as the browser tells: then smooth edges cost more than they give. */
export function isSoftware(): boolean {
  if (software === undefined) {
    const gl = document.createElement("canvas").getContext("webgl2");
    const info = gl?.getExtension("WEBGL_debug_renderer_info");
    const name = gl && info ? String(gl.getParameter(info.UNMASKED_RENDERER_WEBGL)) : "";
    software = /swiftshader|llvmpipe|software/i.test(name);
    gl?.getExtension("WEBGL_lose_context")?.loseContext();
  }
  return software;
}
