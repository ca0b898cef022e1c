import assert from "node:assert/strict";
import { test } from "node:test";
import { CostMap } from "../src/cost_map";
import { fill, spectrum } from "../src/spectrum";

test("two sines stand at their frequencies with their amplitudes", () => {
  const dt = 0.005,
    n = 12000,
    x = Float64Array.from(
      { length: n },
      (_, i) => 40 + 2.2 * Math.sin(4.5 * i * dt) + 0.03 * Math.sin(2 * Math.PI * 17 * i * dt),
    );
  const { f, amplitude } = spectrum(x, dt);
  assert.ok(amplitude.every((a) => a >= 0)); // up to the last line, at half the sampling rate
  assert.ok(Math.abs(f.at(-1)! * 2 * dt - 1) < 0.03);
  for (const [frequency, size] of [
    [4.5 / (2 * Math.PI), 2.2],
    [17, 0.03],
  ] as const) {
    const near = f
      .map((v, i) => [v, amplitude[i]!] as const)
      .filter(([v]) => Math.abs(v / frequency - 1) < 0.05);
    const [at, peak] = near.reduce((a, b) => (b[1] > a[1] ? b : a));
    assert.ok(Math.abs(at - frequency) < 1 / (n * dt), `${at}`); // one line of the spectrum
    assert.ok(peak > 0.85 * size && peak < 1.02 * size, `${peak}`); // Hann: less between two lines
  }
});

test("a missed step keeps its place, and only the run that goes on counts", () => {
  assert.deepEqual(
    [...fill([7, 8, 9, 0, 1, 4, 5], [9, 9, 9, 1, 2, 3, 4], 100)],
    [1, 2, 2, 2, 3, 4],
  );
  assert.deepEqual([...fill([0, 1, 2], [1, NaN, 3], 100)], [1, 1, 3]);
  assert.equal(fill([0, 1, 1e9], [1, 2, 3], 100).length, 1); // a jump
  assert.equal(fill([], [], 100).length, 0);
});

test("the map keeps mean, least and largest r of each theta, wherever theta goes", () => {
  const map = new CostMap(),
    cost = (theta: number): number => (theta + 3) ** 2;
  for (let i = 0; i <= 20000; i += 1) {
    const theta = 2 - 7 * (i / 20000);
    map.push(i * 0.005, theta, cost(theta) + (i % 2 ? 0.5 : -0.5));
  }
  const { theta, mean, least, most } = map.bins();
  assert.ok(theta.length > 25 && theta.length <= 120);
  assert.ok(theta[0]! < -4.8 && theta.at(-1)! > 1.8);
  const width = theta[1]! - theta[0]!;
  theta.forEach((middle, i) => {
    if (i === 0 || i === theta.length - 1) return; // only a part of these was visited
    const slope = Math.abs(2 * (middle + 3)) * width + width * width;
    assert.ok(Math.abs(mean[i]! - cost(middle)) <= slope, `${middle}: ${mean[i]}`);
    assert.ok(most[i]! - least[i]! >= 0.99 && most[i]! - least[i]! <= 1 + 2 * slope);
  });
  assert.ok(map.trailSince(0).length <= 1200);
});
