/** The heights of added posts, coded as differences from what their diamonds foretell (WIRE.md, "Heights"). */

import { type BitReader, Context, PayloadError } from "./bits";

const MEAN_AT_START = 1024;
const SHORTER = [128, 106, 90, 80, 80, 80, 80, 80];
const NEGATIVE = [128, 128, 144, 112, 160, 96];

/** Number of binary digits of |x|. */
export function length(x: number): number {
  const size = Math.abs(x);
  if (size < 2 ** 32) return 32 - Math.clz32(size);
  return 32 + length(Math.floor(size / 2 ** 32));
}

/** Reads heights, in the order of the payload. */
export class HeightReader {
  private mean = MEAN_AT_START;
  private readonly isLong = new Context(112, 4);
  private readonly longer = Array.from({ length: 8 }, (_, k) => new Context(k === 0 ? 76 : 56, 4));
  private readonly shorter = SHORTER.map((a) => new Context(a, 4));
  private readonly negative = NEGATIVE.map((a) => new Context(a, 4));
  private readonly second = Array.from({ length: 16 }, () => new Context(112, 2));

  constructor(private readonly bits: BitReader) {}

  /** The length that a snapshot expects of the next difference. */
  expected(): number {
    return length(Math.floor(this.mean / 16));
  }

  /**
   * The next height. `base` and `apexes` are the sums of the heights of the ends of the diamond's base and of its apexes,
   * `expected` the length that is expected of the difference.
   */
  read(base: number, apexes: number, expected: number): number {
    const difference = this.difference(apexes - base, expected);
    this.mean += Math.abs(difference) - Math.floor(this.mean / 16);
    const height = Math.floor((apexes + base) / 4) + difference;
    if (height < -(2 ** 31) || height >= 2 ** 31) throw new PayloadError("a height beyond 32 bits");
    return height;
  }

  private difference(slope: number, x: number): number {
    const digits = this.digits(x);
    if (digits === 0) return 0;
    const size = length(slope);
    const steepness = (size >= x ? 1 : 0) + (size > x + 1 ? 1 : 0);
    const isNegative = this.bits.bit(at(this.negative, 2 * steepness + (slope < 0 ? 1 : 0)));
    let value = 1;
    if (digits > 1) {
      const place = Math.max(0, Math.min(15, 8 + digits - x));
      value = 2 + (this.bits.bit(at(this.second, place)) ? 1 : 0);
    }
    if (digits > 2) value = value * 2 ** (digits - 2) + this.bits.raw(digits - 2);
    return isNegative ? -value : value;
  }

  /** The number of binary digits of the difference. */
  private digits(x: number): number {
    if (x === 0 || this.bits.bit(this.isLong)) {
      let y = x;
      while (y < 32 && this.bits.bit(at(this.longer, Math.min(7, y - x)))) y += 1;
      return y;
    }
    let y = x - 1;
    while (y > 0 && this.bits.bit(at(this.shorter, Math.min(7, x - 1 - y)))) y -= 1;
    return y;
  }
}

/** An element that is there. */
export function at<T>(list: readonly T[], n: number): T {
  const found = list[n];
  if (found === undefined) throw new RangeError(`no element ${n} among ${list.length}`);
  return found;
}
