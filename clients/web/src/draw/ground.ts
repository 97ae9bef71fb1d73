/**
 * A mesh as it is drawn: every triangle with its own three vertices, so that a triangle can have a colour and its edges
 * can be found in the shader (`gl_VertexID` tells the corner). Normals are those of the posts, averaged by area.
 */

import {
  BufferAttribute, BufferGeometry, Color, DataTexture, DynamicDrawUsage, GLSL3, Mesh as Drawn, NearestFilter, RedFormat,
  ShaderMaterial, UnsignedByteType, Vector2, Vector3, Vector4,
} from "three";
import type { Vertex, Walkable } from "../mesh/mesh";
import type { Space } from "./space";

/** Colours of heights from lowest to highest. */
const RELIEF = ["#3a5a4c", "#557257", "#83895c", "#a8946a", "#b9a588", "#d8cfc2"];
/** Colours of errors; see `ERROR_STEPS_M`. */
export const ERROR_COLOURS = ["#2a3a45", "#38626e", "#68998c", "#cdbf8d", "#cf8f63", "#a94a62"];
/** Errors in metres at which those colours stand; between them they blend in logarithms. */
export const ERROR_STEPS_M = [0.3, 1, 3, 10, 30, 100];
export const HAZE = "#22303a";
/** Where there is no data. */
export const VOID_COLOUR = "#8fb6d9";

const VERTEX = /* glsl */ `
  in float error;
  out vec3 vAt;
  out vec3 vNormal;
  out vec3 vBary;
  out float vDepth;
  flat out float vError;
  void main() {
    int corner = gl_VertexID % 3;
    vBary = vec3(corner == 0, corner == 1, corner == 2);
    vAt = position;
    vNormal = normal;
    vError = error;
    vec4 seen = viewMatrix * vec4(position, 1.0);
    vDepth = -seen.z;
    gl_Position = projectionMatrix * seen;
  }`;

const FRAGMENT = /* glsl */ `
  precision highp float;
  in vec3 vAt;
  in vec3 vNormal;
  in vec3 vBary;
  in float vDepth;
  flat in float vError;
  out vec4 colour;
  uniform vec3 ramp[6];
  uniform vec3 errors[6];
  uniform vec3 haze;
  uniform vec2 heights;
  uniform vec2 extent;
  uniform float hazeAt;
  uniform bool showsError;
  uniform float wire;
  uniform sampler2D viewshed;
  uniform vec4 viewshedAt;
  uniform bool showsViewshed;
  uniform sampler2D voids;
  uniform vec2 voidsScale;
  uniform bool showsVoids;
  uniform vec3 voidColour;
  uniform vec3 ring;

  vec3 along(vec3 colours[6], float place) {
    float at = clamp(place, 0.0, 1.0) * 5.0;
    int low = min(int(at), 4);
    return mix(colours[low], colours[low + 1], at - float(low));
  }

  void main() {
    // Padding beyond the last posts is part of the mesh, not of the terrain.
    if (any(greaterThan(abs(vAt.xy), extent))) discard;
    vec3 normal = normalize(vNormal);
    vec3 base = along(ramp, (vAt.z - heights.x) / max(heights.y - heights.x, 1.0));
    base = mix(base, vec3(0.42, 0.37, 0.32), clamp(1.6 * (0.86 - normal.z), 0.0, 0.55));
    if (showsError) base = along(errors, log(max(vError, 1e-3) / 0.3) / log(100.0 / 0.3));
    if (showsVoids && texture(voids, 0.5 + vAt.xy * voidsScale).r > 0.5) base = voidColour;
    // The sun of maps: from the north-west, and lower than it stands at noon.
    float sun = dot(normal, normalize(vec3(-0.66, 0.5, 0.56)));
    float light = 0.16 + 1.18 * pow(max(sun, 0.0), 1.25) + 0.18 * normal.z;
    vec3 lit = base * light;
    if (showsViewshed) {
      vec2 at = (vAt.xy - viewshedAt.xy) * viewshedAt.zw;
      if (all(greaterThanEqual(at, vec2(0.0))) && all(lessThan(at, vec2(1.0)))) {
        float verdict = texture(viewshed, at).r * 255.0;
        if (verdict > 2.5) lit = mix(lit, vec3(0.09, 0.08, 0.2) * light, 0.62);
        else if (verdict > 1.5) lit = mix(lit, vec3(0.5), 0.5);
        else if (verdict > 0.5) lit = mix(lit, vec3(1.0, 0.82, 0.42) * light, 0.55);
      }
    }
    if (ring.z > 0.0) {
      float off = distance(vAt.xy, ring.xy) - ring.z;
      lit = mix(lit, vec3(0.2, 0.53, 0.92), 0.85 * (1.0 - smoothstep(0.8, 1.8, abs(off) / fwidth(off))));
    }
    vec3 near = vBary / fwidth(vBary);
    float edge = 1.0 - smoothstep(0.15, 1.15, min(min(near.x, near.y), near.z));
    // Where triangles are no larger than pixels their edges would be all there is.
    float fade = 1.0 - smoothstep(0.25, 0.7, max(max(fwidth(vBary).x, fwidth(vBary).y), fwidth(vBary).z));
    lit = mix(lit, vec3(0.04, 0.07, 0.09), edge * wire * fade);
    lit = mix(lit, haze, 1.0 - exp(-pow(vDepth / hazeAt, 1.6)));
    colour = vec4(pow(lit, vec3(1.0 / 2.2)), 1.0);
  }`;

const linear = (list: string[]) => list.map((hex) => new Color(hex)).map((c) => new Vector3(c.r, c.g, c.b));

/** A byte a cell, row by row from the south: a texture to be. */
interface Cells {
  readonly cells: Uint8Array<ArrayBuffer>;
  readonly width: number;
  readonly height: number;
}

/** A viewshed: verdict numbers, and where its first post lies. */
export interface Overlay extends Cells {
  readonly firstI: number;
  readonly firstJ: number;
}

/** Whether there is data, at posts spread evenly from the first to the last: 255 where there is none. */
export type VoidMask = Cells;

export class Ground {
  readonly drawn: Drawn<BufferGeometry, ShaderMaterial>;
  private positions = new BufferAttribute(new Float32Array(0), 3);
  private normals = new BufferAttribute(new Float32Array(0), 3);
  private errors = new BufferAttribute(new Float32Array(0), 1);

  constructor(private readonly space: Space) {
    const material = new ShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      polygonOffset: true,
      polygonOffsetFactor: 1,
      polygonOffsetUnits: 2,
      uniforms: {
        ramp: { value: linear(RELIEF) },
        errors: { value: linear(ERROR_COLOURS) },
        haze: { value: linear([HAZE])[0] },
        heights: { value: new Vector2(space.low, space.high) },
        extent: { value: new Vector2(space.east / 2, space.north / 2) },
        hazeAt: { value: 1 },
        showsError: { value: false },
        wire: { value: 0.35 },
        viewshed: { value: null },
        viewshedAt: { value: new Vector4() },
        showsViewshed: { value: false },
        voids: { value: null },
        voidsScale: { value: new Vector2() },
        showsVoids: { value: false },
        voidColour: { value: linear([VOID_COLOUR])[0] },
        ring: { value: new Vector3() },
      },
    });
    this.drawn = new Drawn(new BufferGeometry(), material);
    this.drawn.frustumCulled = false;
  }

  set wire(strength: number) {
    this.uniform("wire").value = strength;
  }

  set showsError(shows: boolean) {
    this.uniform("showsError").value = shows;
  }

  /** Draws a circle around a place of the local frame; undefined: none. */
  set ring(ring: { x: number; y: number; radius: number } | undefined) {
    (this.uniform("ring").value as Vector3).set(ring?.x ?? 0, ring?.y ?? 0, ring?.radius ?? 0);
  }

  /** Distance in metres at which the air takes over. */
  set hazeAt(metres: number) {
    this.uniform("hazeAt").value = metres;
  }

  set voids(mask: VoidMask | undefined) {
    this.show("voids", "showsVoids", mask);
    if (!mask) return;
    // The middles of the outer texels are the outer posts, and the local frame's origin is the middle of all.
    const { east, north } = this.space;
    this.uniform("voidsScale").value = new Vector2((mask.width - 1) / (mask.width * east), (mask.height - 1) / (mask.height * north));
  }

  set overlay(overlay: Overlay | undefined) {
    this.show("viewshed", "showsViewshed", overlay);
    if (!overlay) return;
    const { scale } = this.space;
    // The texel of a post has the post in its middle.
    const first = this.space.localFromGrid({ x: overlay.firstI - 0.5, y: overlay.firstJ - 0.5, z: 0 });
    this.uniform("viewshedAt").value = new Vector4(first.x, first.y, 1 / (overlay.width * scale.x), 1 / (overlay.height * scale.y));
  }

  /** Puts a byte a cell into a texture in place of the one before, or nothing. */
  private show(name: string, isShown: string, cells: Cells | undefined): void {
    const slot = this.uniform(name);
    (slot.value as DataTexture | null)?.dispose();
    slot.value = null;
    this.uniform(isShown).value = cells !== undefined;
    if (!cells) return;
    const texture = new DataTexture(cells.cells, cells.width, cells.height, RedFormat, UnsignedByteType);
    texture.minFilter = texture.magFilter = NearestFilter;
    texture.unpackAlignment = 1;
    texture.needsUpdate = true;
    slot.value = texture;
  }

  /** Takes the triangles of a mesh. `errorAt` gives a triangle's error in metres, by the middle of its base. */
  take(mesh: Walkable, errorAt?: (e0: Vertex, e1: Vertex) => number): void {
    const count = mesh.triangleCount;
    this.reserve(3 * count);
    const { positions, normals, errors, space } = this;
    const [xyz, steep, error] = [positions.array as Float32Array, normals.array as Float32Array, errors.array as Float32Array];
    const sums = new Map<number, Vector3>();
    const keys = new Float64Array(3 * count);
    const [p, q, r] = [new Vector3(), new Vector3(), new Vector3()];
    let n = 0;
    mesh.walk((apex, e0, e1) => {
      const corners = [apex, e1, e0];
      [p, q, r].forEach((at, k) => {
        const corner = corners[k] as Vertex;
        space.localFromGrid({ x: corner.i, y: corner.j, z: corner.z }, at);
        at.toArray(xyz, 3 * (n + k));
        keys[n + k] = mesh.grid.key(corner.i, corner.j);
      });
      const normal = q.sub(p).cross(r.sub(p));
      for (let k = 0; k < 3; k++) {
        const key = keys[n + k] as number;
        const sum = sums.get(key);
        if (sum) sum.add(normal);
        else sums.set(key, normal.clone());
      }
      error.fill(errorAt?.(e0, e1) ?? 0, n, n + 3);
      n += 3;
    });
    for (const sum of sums.values()) sum.normalize();
    for (let k = 0; k < n; k++) sums.get(keys[k] as number)?.toArray(steep, 3 * k);
    for (const attribute of [positions, normals, errors]) attribute.needsUpdate = true;
    this.drawn.geometry.setDrawRange(0, n);
  }

  dispose(): void {
    this.overlay = undefined;
    this.voids = undefined;
    this.drawn.geometry.dispose();
    this.drawn.material.dispose();
  }

  /** Makes room; in steps, so that a mesh that grows does not ask for new buffers every time. */
  private reserve(vertices: number): void {
    if (this.positions.count >= vertices) return;
    const room = Math.ceil((vertices * 1.25) / 300) * 300;
    this.drawn.geometry.dispose();
    const make = (size: number) => new BufferAttribute(new Float32Array(room * size), size).setUsage(DynamicDrawUsage);
    [this.positions, this.normals, this.errors] = [make(3), make(3), make(1)];
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", this.positions);
    geometry.setAttribute("normal", this.normals);
    geometry.setAttribute("error", this.errors);
    this.drawn.geometry = geometry;
  }

  private uniform(name: string): { value: unknown } {
    const found = this.drawn.material.uniforms[name];
    if (!found) throw new Error(`no uniform ${name}`);
    return found;
  }
}
