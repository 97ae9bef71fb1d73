/** A camera that looks at a place of the ground, from a distance, an azimuth and an elevation. */

import { Matrix4, Quaternion, Vector3 } from "three";

const LEAST_ELEVATION = 0.03;
const GREATEST_ELEVATION = Math.PI / 2 - 0.02;
const UP = new Vector3(0, 0, 1);

export class Orbit {
  constructor(
    /** What it looks at, in the local frame. */
    readonly target: Vector3,
    /** Metres from the target to the eye. */
    public distance: number,
    /** Direction in which it looks, clockwise from north, in radians. */
    public azimuth: number,
    /** How far it looks down, in radians. */
    public elevation: number,
    private readonly leastDistance: number,
    private readonly greatestDistance: number,
  ) {}

  clone(): Orbit {
    const { target, distance, azimuth, elevation, leastDistance, greatestDistance } = this;
    return new Orbit(target.clone(), distance, azimuth, elevation, leastDistance, greatestDistance);
  }

  /** Becomes as another one. */
  follow(other: Orbit): void {
    this.target.copy(other.target);
    [this.distance, this.azimuth, this.elevation] = [other.distance, other.azimuth, other.elevation];
  }

  turn(azimuth: number, elevation: number): void {
    this.azimuth += azimuth;
    this.elevation = Math.min(Math.max(this.elevation + elevation, LEAST_ELEVATION), GREATEST_ELEVATION);
  }

  /** Moves the target to the right and ahead as seen, in metres. */
  pan(right: number, ahead: number): void {
    const [sin, cos] = [Math.sin(this.azimuth), Math.cos(this.azimuth)];
    this.target.x += right * cos + ahead * sin;
    this.target.y += ahead * cos - right * sin;
  }

  zoom(factor: number): void {
    this.distance = Math.min(Math.max(this.distance * factor, this.leastDistance), this.greatestDistance);
  }

  /** Eye and orientation in the local frame (x right, y up, looking along -z). */
  pose(): { eye: Vector3; rotation: Quaternion } {
    const level = Math.cos(this.elevation) * this.distance;
    const eye = new Vector3(
      this.target.x - Math.sin(this.azimuth) * level,
      this.target.y - Math.cos(this.azimuth) * level,
      this.target.z + Math.sin(this.elevation) * this.distance,
    );
    const rotation = new Quaternion().setFromRotationMatrix(new Matrix4().lookAt(eye, this.target, UP));
    return { eye, rotation };
  }
}
