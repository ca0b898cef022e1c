// The cost over theta, as it is explored.

const BINS = 120;
const MEMORY = 2000; // samples after which a bin's mean follows what is new: the map may drift
const TRAIL = 1200; // points of the path
const TRAIL_STEP = 0.05; // [s] between two points of the path

/** Mean, least and largest r in a part of theta's range. */
interface Bin {
  n: number;
  mean: number;
  least: number;
  most: number;
}

/** The cost in each part of theta's range, and the path of the last while. */
export class CostMap {
  private low = 0;
  private width = 0;
  private visited: (Bin | undefined)[] = [];
  private trail: { t: number; theta: number; r: number }[] = [];

  clear(): void {
    this.width = 0;
    this.visited = [];
    this.trail = [];
  }

  push(t: number, theta: number, r: number): void {
    if (!Number.isFinite(theta) || !Number.isFinite(r)) return;
    this.include(theta);
    const i = Math.min(BINS - 1, Math.floor((theta - this.low) / this.width));
    this.visited[i] = join(this.visited[i], { n: 1, mean: r, least: r, most: r });
    const end = this.trail.at(-1);
    if (!end || t - end.t >= TRAIL_STEP || t < end.t) this.trail.push({ t, theta, r });
    if (this.trail.length > TRAIL) this.trail.splice(0, TRAIL / 4);
  }

  /** The run has begun again: what follows is not joined to what was. */
  restart(): void {
    this.trail = [];
  }

  /** The parts that were visited: middle, mean, least, largest. */
  bins(): { theta: number[]; mean: number[]; least: number[]; most: number[] } {
    const visited = [...this.visited.entries()].filter((item): item is [number, Bin] => !!item[1]);
    return {
      theta: visited.map(([i]) => this.low + (i + 0.5) * this.width),
      mean: visited.map(([, bin]) => bin.mean),
      least: visited.map(([, bin]) => bin.least),
      most: visited.map(([, bin]) => bin.most),
    };
  }

  /** Where r and theta were since a time. */
  trailSince(from: number): readonly { t: number; theta: number; r: number }[] {
    return this.trail.filter((point) => point.t >= from);
  }

  /** Widen the range until theta is in it; two bins become one each time. */
  private include(theta: number): void {
    if (this.width === 0) {
      this.width = 1 / 1024 / BINS; // nothing is known of the first theta; it doubles soon enough
      this.low = Math.floor(theta / (this.width * BINS)) * this.width * BINS;
    }
    while (theta >= this.low + BINS * this.width || theta < this.low) {
      const isBelow = theta < this.low;
      const before = this.visited;
      this.visited = [];
      before.forEach((bin, i) => {
        const k = (i >> 1) + (isBelow ? BINS / 2 : 0);
        if (bin) this.visited[k] = join(this.visited[k], bin);
      });
      if (isBelow) this.low -= BINS * this.width;
      this.width *= 2;
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
