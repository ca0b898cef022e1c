// The cost over theta, as it is explored.

const BINS = 120;
const FINEST = 2 ** -17; // width of a bin at first
const MEMORY = 2000; // samples after which a bin's mean follows what is new: the map may drift

/** Mean, least and largest r in a part of theta's range. */
interface Bin {
  n: number;
  mean: number;
  least: number;
  most: number;
}

/** The cost in each part of theta's range. */
export class CostMap {
  private width = FINEST;
  private visited = new Map<number, Bin>();

  clear(): void {
    this.width = FINEST;
    this.visited.clear();
  }

  push(theta: number, r: number): void {
    if (!Number.isFinite(theta) || !Number.isFinite(r)) return;
    const at = Math.floor(theta / this.width);
    this.visited.set(at, join(this.visited.get(at), { n: 1, mean: r, least: r, most: r }));
    while (this.visited.size > BINS) this.widen();
  }

  /** The parts that were visited: middle, mean, least, largest. */
  bins(): { theta: number[]; mean: number[]; least: number[]; most: number[] } {
    const visited = [...this.visited].sort(([a], [b]) => a - b);
    return {
      theta: visited.map(([at]) => (at + 0.5) * this.width),
      mean: visited.map(([, bin]) => bin.mean),
      least: visited.map(([, bin]) => bin.least),
      most: visited.map(([, bin]) => bin.most),
    };
  }

  /** Make one of every two bins. */
  private widen(): void {
    const before = this.visited;
    this.width *= 2;
    this.visited = new Map();
    for (const [at, bin] of before) {
      const half = Math.floor(at / 2);
      this.visited.set(half, join(this.visited.get(half), bin));
    }
  }
}

function join(a: Bin | undefined, b: Bin): Bin {
  if (!a) return b;
  const n = a.n + b.n;
  return {
    n: Math.min(n, MEMORY),
    mean: a.mean + ((b.mean - a.mean) * b.n) / n,
    least: Math.min(a.least, b.least),
    most: Math.max(a.most, b.most),
  };
}
