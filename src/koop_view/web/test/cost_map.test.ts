import assert from "node:assert/strict";
import { test } from "node:test";
import { CostMap } from "../src/cost_map";

test("the map keeps mean, least and largest r of each theta, wherever theta goes", () => {
  const map = new CostMap(),
    cost = (theta: number): number => (theta + 3) ** 2;
  for (let i = 0; i <= 20000; i += 1) {
    const theta = 2 - 7 * (i / 20000);
    map.push(theta, cost(theta) + (i % 2 ? 0.5 : -0.5));
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
});
