/**
 * Lines and dots of a width in pixels. What stands behind the ground is drawn, too, but faintly: a sight line that
 * disappears in a hill is what this page is about.
 */

import {
  Color, GLSL3, GreaterDepth, InstancedBufferAttribute, InstancedBufferGeometry, Float32BufferAttribute, LessEqualDepth, Mesh,
  ShaderMaterial, Vector2, type Vector3, Group,
} from "three";

export interface Stroke {
  readonly from: Vector3;
  /** The same place for a dot. */
  readonly to: Vector3;
  readonly colour: string;
  readonly opacity: number;
  readonly widthPx: number;
  readonly isDashed: boolean;
}

const VERTEX = /* glsl */ `
  in vec3 from;
  in vec3 to;
  in vec4 tint;
  in vec2 look;
  uniform vec2 viewport;
  out vec4 vTint;
  out vec2 vPlace;
  out float vLength;
  out float vHalf;
  flat out float vDashed;
  void main() {
    vec4 a = projectionMatrix * viewMatrix * vec4(from, 1.0);
    vec4 b = projectionMatrix * viewMatrix * vec4(to, 1.0);
    // What is behind the eye would be mirrored: cut at the near plane.
    float nearA = a.z + a.w;
    float nearB = b.z + b.w;
    vTint = tint;
    vDashed = look.y;
    if (nearA <= 0.0 && nearB <= 0.0) { gl_Position = vec4(2.0, 2.0, 2.0, 1.0); return; }
    if (nearA < 0.0) a = mix(a, b, (nearA - 1e-6) / (nearA - nearB));
    if (nearB < 0.0) b = mix(b, a, (nearB - 1e-6) / (nearB - nearA));
    vec3 p = a.xyz / a.w;
    vec3 q = b.xyz / b.w;
    vec2 way = (q.xy - p.xy) * viewport * 0.5;
    vLength = length(way);
    vec2 ahead = vLength > 1e-3 ? way / vLength : vec2(1.0, 0.0);
    vHalf = look.x * 0.5;
    float reach = vHalf + 1.0;
    bool isEnd = position.x > 0.5;
    vPlace = vec2(isEnd ? vLength + reach : -reach, position.y * reach);
    vec2 moved = ahead * (isEnd ? reach : -reach) + vec2(-ahead.y, ahead.x) * vPlace.y;
    vec3 at = isEnd ? q : p;
    gl_Position = vec4(at.xy + moved / viewport * 2.0, at.z, 1.0);
  }`;

const FRAGMENT = /* glsl */ `
  precision highp float;
  in vec4 vTint;
  in vec2 vPlace;
  in float vLength;
  in float vHalf;
  flat in float vDashed;
  uniform float strength;
  out vec4 colour;
  void main() {
    float beyond = max(max(-vPlace.x, vPlace.x - vLength), 0.0);
    float off = length(vec2(beyond, vPlace.y));
    float cover = clamp(vHalf + 0.5 - off, 0.0, 1.0);
    if (vDashed > 0.5) cover *= smoothstep(0.0, 1.0, abs(mod(vPlace.x, 11.0) - 5.5) - 2.2);
    if (cover <= 0.0) discard;
    colour = vec4(vTint.rgb, vTint.a * cover * strength);
  }`;

export class Strokes {
  readonly drawn = new Group();
  private readonly parts: Mesh<InstancedBufferGeometry, ShaderMaterial>[];

  constructor() {
    const make = (strength: number, isBehind: boolean) => {
      const material = new ShaderMaterial({
        glslVersion: GLSL3,
        vertexShader: VERTEX,
        fragmentShader: FRAGMENT,
        transparent: true,
        depthWrite: false,
        depthFunc: isBehind ? GreaterDepth : LessEqualDepth,
        uniforms: { viewport: { value: new Vector2(1, 1) }, strength: { value: strength } },
      });
      const part = new Mesh(new InstancedBufferGeometry(), material);
      part.frustumCulled = false;
      part.renderOrder = isBehind ? 1 : 2;
      this.drawn.add(part);
      return part;
    };
    this.parts = [make(0.5, true), make(1, false)];
  }

  set viewport([width, height]: readonly [number, number]) {
    for (const { material } of this.parts) (material.uniforms["viewport"]?.value as Vector2).set(width, height);
  }

  take(strokes: readonly Stroke[]): void {
    const geometry = new InstancedBufferGeometry();
    geometry.setAttribute("position", new Float32BufferAttribute([0, -1, 0, 1, -1, 0, 1, 1, 0, 0, 1, 0], 3));
    geometry.setIndex([0, 1, 2, 0, 2, 3]);
    const column = (size: number, of: (stroke: Stroke) => number[]) =>
      new InstancedBufferAttribute(Float32Array.from(strokes.flatMap(of)), size);
    geometry.setAttribute("from", column(3, (s) => s.from.toArray()));
    geometry.setAttribute("to", column(3, (s) => s.to.toArray()));
    geometry.setAttribute("tint", column(4, (s) => [...srgb(s.colour), s.opacity]));
    geometry.setAttribute("look", column(2, (s) => [s.widthPx, s.isDashed ? 1 : 0]));
    geometry.instanceCount = strokes.length;
    this.parts[0]?.geometry.dispose();
    for (const part of this.parts) part.geometry = geometry;
    this.drawn.visible = strokes.length > 0;
  }

  dispose(): void {
    this.parts[0]?.geometry.dispose();
    for (const { material } of this.parts) material.dispose();
  }
}

function srgb(hex: string): [number, number, number] {
  const c = new Color(hex).convertLinearToSRGB();
  return [c.r, c.g, c.b];
}
