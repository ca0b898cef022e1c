// The cost over theta, as it is explored.

const BINS = 120;
const MEMORY = 2000; // samples after which a bin's mean follows what is new: the map may drift
const TRAIL = 1200;

/** Mean, least and largest r of each part of theta's range, and the way of the last while. */
export class CostMap {
  private low = 0;
  private width = 0;
  private mean = new Float64Array(BINS);
  private least = new Float64Array(BINS);
  private most = new Float64Array(BINS);
  private n = new Float64Array(BINS);
  private trail: { t: number; theta: number; r: number }[] = [];
  private trailStep = 0.05; // [s] between two points of the way

  clear(): void {
    this.width = 0;
    this.n.fill(0);
    this.trail = [];
  }

  push(t: number, theta: number, r: number): void {
    if (!Number.isFinite(theta) || !Number.isFinite(r)) return;
    this.include(theta);
    const i = Math.min(BINS - 1, Math.floor((theta - this.low) / this.width));
    if (this.n[i] === 0) {
      this.mean[i] = this.least[i] = this.most[i] = r;
      this.n[i] = 1;
    } else {
      this.n[i] = Math.min(this.n[i]! + 1, MEMORY);
      this.mean[i] = this.mean[i]! + (r - this.mean[i]!) / this.n[i]!;
      this.least[i] = Math.min(this.least[i]!, r);
      this.most[i] = Math.max(this.most[i]!, r);
    }
    const end = this.trail[this.trail.length - 1];
    if (!end || t - end.t >= this.trailStep || t < end.t) this.trail.push({ t, theta, r });
    if (this.trail.length > TRAIL) this.trail.splice(0, TRAIL / 4);
  }

  /** The run has begun again: what follows is not joined to what was. */
  restart(): void {
    this.trail = [];
  }

  /** The parts that were visited: middle, mean, least, largest. */
  bins(): { theta: number[]; mean: number[]; least: number[]; most: number[] } {
    const found = { theta: [] as number[], mean: [] as number[], least: [] as number[], most: [] as number[] };
    for (let i = 0; i < BINS; i += 1) {
      if (!this.n[i]) continue;
      found.theta.push(this.low + (i + 0.5) * this.width);
      found.mean.push(this.mean[i]!);
      found.least.push(this.least[i]!);
      found.most.push(this.most[i]!);
    }
    return found;
  }

  /** Where r and theta were since `from`. */
  way(from: number): readonly { t: number; theta: number; r: number }[] {
    return this.trail.filter((point) => point.t >= from);
  }

  /** Widen the range until theta is in it; two bins become one each time. */
  private include(theta: number): void {
    if (this.width === 0) {
      this.width = 1 / 1024 / BINS; // of the first theta nothing is known; it doubles soon enough
      this.low = Math.floor(theta / (this.width * BINS)) * this.width * BINS;
    }
    while (theta >= this.low + BINS * this.width || theta < this.low) {
      const down = theta < this.low, offset = down ? BINS / 2 : 0;
      const [mean, least, most, n] = [this.mean, this.least, this.most, this.n];
      const empty = (): Float64Array<ArrayBuffer> => new Float64Array(BINS);
      [this.mean, this.least, this.most, this.n] = [empty(), empty(), empty(), empty()];
      for (let i = 0; i < BINS; i += 1) {
        if (!n[i]) continue;
        const k = (i >> 1) + offset, all = this.n[k]! + n[i]!;
        this.least[k] = this.n[k] ? Math.min(this.least[k]!, least[i]!) : least[i]!;
        this.most[k] = this.n[k] ? Math.max(this.most[k]!, most[i]!) : most[i]!;
        this.mean[k] = (this.mean[k]! * this.n[k]! + mean[i]! * n[i]!) / all;
        this.n[k] = Math.min(all, MEMORY);
      }
      if (down) this.low -= BINS * this.width;
      this.width *= 2;
    }
  }
}
