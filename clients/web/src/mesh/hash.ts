/** The order-free hash of a mesh (WIRE.md, "The hash"). All arithmetic is modulo 2^64. */

const MASK = (1n << 64n) - 1n;

function mix(n: bigint): bigint {
  let z = (n + 0x9e3779b97f4a7c15n) & MASK;
  z = ((z ^ (z >> 30n)) * 0xbf58476d1ce4e5b9n) & MASK;
  z = ((z ^ (z >> 27n)) * 0x94d049bb133111ebn) & MASK;
  return z ^ (z >> 31n);
}

/** What the active post (i, j) with a height of 32 bits adds to the hash. */
export function postHash(i: number, j: number, height: number): bigint {
  return mix(mix((BigInt(j) << 32n) + BigInt(i)) ^ BigInt(height >>> 0));
}

/** The sum of two hashes. */
export function add(a: bigint, b: bigint): bigint {
  return (a + b) & MASK;
}

/** A hash without what a post added. */
export function subtract(a: bigint, b: bigint): bigint {
  return (a - b) & MASK;
}
