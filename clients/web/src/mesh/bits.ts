/**
 * The bits of a mesh payload under adaptive contexts (WIRE.md, "Coding bits"). All numbers are integers below 2^33, which
 * doubles hold exactly; there is one payload for each sequence of bits, and `finish` refuses every other one.
 */

/** The payload is none that an encoder makes. */
export class PayloadError extends Error {
  override readonly name = "PayloadError";
}

const WORD = 2 ** 32;
const RENORMALISE_BELOW = 2 ** 24;
const MOST_SEEN = 60;

/** The probability of a 1, in units of 2^-16, and how much has been learnt. */
export class Context {
  private one: number;

  constructor(
    initial: number,
    private seen: number,
  ) {
    this.one = initial * 256;
  }

  /** The share of `range` that stands for a 1. */
  part(range: number): number {
    return Math.floor(range / 65536) * this.one;
  }

  learn(bit: boolean): void {
    const pace = Math.floor(131072 / (2 * this.seen + 3));
    this.one += bit ? Math.floor(((65536 - this.one) * pace) / 65536) : -Math.floor((this.one * pace) / 65536);
    this.one = Math.min(Math.max(this.one, 32), 65536 - 32);
    this.seen = Math.min(this.seen + 1, MOST_SEEN);
  }
}

/** Reads the bits that follow the first byte of a payload. */
export class BitReader {
  private range = WORD - 1;
  private above: number;
  private steps = 0;

  constructor(private readonly bytes: Uint8Array) {
    this.above = this.word(0);
    if (this.above === WORD - 1) throw new PayloadError("the first four bytes are all ones");
  }

  /** One bit under a context, which learns it. */
  bit(context: Context): boolean {
    const part = context.part(this.range);
    const bit = this.above < part;
    if (bit) {
      this.range = part;
    } else {
      this.above -= part;
      this.range -= part;
    }
    context.learn(bit);
    this.renormalise();
    return bit;
  }

  /** A number of `digits` binary digits. */
  raw(digits: number): number {
    let value = 0;
    for (let left = digits; left > 0; ) {
      const width = Math.min(left, 8);
      this.range = Math.floor(this.range / 2 ** width);
      const piece = Math.floor(this.above / this.range);
      if (piece >= 2 ** width) throw new PayloadError("raw digits beyond their width");
      this.above -= piece * this.range;
      this.renormalise();
      value = value * 2 ** width + piece;
      left -= width;
    }
    return value;
  }

  /** Checks that the payload ends here, in the one way in which it may. */
  finish(): void {
    const word = this.word(this.steps);
    const low = (((word - this.above) % WORD) + WORD) % WORD;
    for (let k = 0; k <= 4; k++) {
      const unit = 2 ** (32 - 8 * k);
      const end = Math.ceil(low / unit) * unit;
      if (end >= low + this.range) continue;
      if (this.bytes.length - 1 !== this.steps + k || word !== end % WORD) break;
      return;
    }
    throw new PayloadError("the payload does not end where its bits do");
  }

  private renormalise(): void {
    while (this.range < RENORMALISE_BELOW) {
      this.above = this.above * 256 + this.byte(this.steps + 4);
      this.range *= 256;
      this.steps += 1;
      if (this.bytes.length - 1 < this.steps) throw new PayloadError("the payload ends too early");
    }
  }

  /** A byte behind the first; those beyond the end are zeros. */
  private byte(n: number): number {
    return this.bytes[n + 1] ?? 0;
  }

  private word(n: number): number {
    return ((this.byte(n) * 256 + this.byte(n + 1)) * 256 + this.byte(n + 2)) * 256 + this.byte(n + 3);
  }
}
