/**
 * The root square and the arithmetic of its diamonds. Every post but the four corners is the centre of one diamond; its
 * shape and children follow from the lowest set bit `b` of `i | j` alone (WIRE.md, "What is encoded").
 */

/** Numbers of posts must be exact in a double: (2^26 + 1)^2 is less than 2^53. */
export const MAX_ROOT_EXPONENT = 26;

/** A post: column eastward, row northward. */
export interface Post {
  readonly i: number;
  readonly j: number;
}

/** A grid of `nx` x `ny` posts in a root square of `side` = 2^exponent cells. */
export class Grid {
  readonly side: number;

  constructor(
    readonly nx: number,
    readonly ny: number,
    readonly exponent: number,
  ) {
    if (!(exponent >= 0 && exponent <= MAX_ROOT_EXPONENT)) {
      throw new RangeError(`a root square of 2^${exponent} cells; this client holds up to 2^${MAX_ROOT_EXPONENT}`);
    }
    this.side = 2 ** exponent;
    if (!(nx >= 2 && ny >= 2 && nx - 1 <= this.side && ny - 1 <= this.side)) {
      throw new RangeError(`${nx} x ${ny} posts do not fit a square of ${this.side} cells`);
    }
  }

  /** The number of a post; the same for no two posts of the square. */
  key(i: number, j: number): number {
    return j * (this.side + 1) + i;
  }

  /** The post of a number. */
  post(key: number): Post {
    const j = Math.floor(key / (this.side + 1));
    return { i: key - j * (this.side + 1), j };
  }

  /** South-west, south-east, north-west, north-east: the order of `TerrainDescription.corner_heights`. */
  corners(): [Post, Post, Post, Post] {
    const s = this.side;
    return [{ i: 0, j: 0 }, { i: s, j: 0 }, { i: 0, j: s }, { i: s, j: s }];
  }

  has(i: number, j: number): boolean {
    return i >= 0 && j >= 0 && i <= this.side && j <= this.side;
  }

  /** How many parents the diamond of (i, j) has, and so how many triangles its split adds: 1 on the border, else 2. */
  parentCount(i: number, j: number): number {
    return i === 0 || j === 0 || i === this.side || j === this.side ? 1 : 2;
  }

  /** The ends of the base that (i, j), no corner, is the middle of. */
  baseEnds(i: number, j: number): [Post, Post] {
    const b = lowestBit(i, j);
    if ((i & b) === 0) return [{ i, j: j - b }, { i, j: j + b }];
    if ((j & b) === 0) return [{ i: i - b, j }, { i: i + b, j }];
    // Of its square's corners, in steps of 2b from the south-west one, the parents are those with an odd sum.
    const isRising = (((i - b) / (2 * b) + (j - b) / (2 * b)) & 1) === 0;
    return isRising ? [{ i: i - b, j: j - b }, { i: i + b, j: j + b }] : [{ i: i - b, j: j + b }, { i: i + b, j: j - b }];
  }

  /** The posts that (i, j), no corner, is a parent of, in the order of WIRE.md. */
  children(i: number, j: number): Post[] {
    const b = lowestBit(i, j);
    const h = b / 2;
    const isSquare = (i & b) !== 0 && (j & b) !== 0;
    if (!isSquare && b === 1) return [];
    const all = isSquare
      ? [{ i, j: j - b }, { i: i - b, j }, { i: i + b, j }, { i, j: j + b }]
      : [{ i: i - h, j: j - h }, { i: i + h, j: j - h }, { i: i - h, j: j + h }, { i: i + h, j: j + h }];
    return all.filter((p) => this.has(p.i, p.j));
  }
}

/** Lowest set bit of i | j, not both 0. */
function lowestBit(i: number, j: number): number {
  const both = i | j;
  return both & -both;
}
