import assert from "node:assert/strict";
import { test } from "node:test";
import { Loop, type Status } from "../src/loop";

const names = {
  namespace: "/",
  plant: "/rig",
  lifter: "/lifter",
  controller: "/esc",
  state: "/state",
  cost: "/cost",
  theta: "/theta",
  guard: null,
};
const status = (name: string, more: Partial<Status> = {}): Status => ({
  name,
  hardware: "koop",
  level: 0,
  message: "",
  values: { lifecycle_state: "active" },
  ...more,
});
const theta = (epsilon: number, holding: boolean): Record<string, unknown> => ({
  step: 1n,
  theta: Float64Array.of(0.5),
  epsilon,
  holding,
  saturated: false,
});

test("a loop that is not shown is judged by the reports of its nodes", () => {
  const loop = new Loop(names);
  assert.equal(loop.level(100), "off");
  for (const name of ["/lifter", "/esc", "/recorder"]) loop.report(status(name), 100);
  assert.equal(loop.level(101), "ok");
  loop.report(status("/recorder", { level: 1 }), 101);
  assert.equal(loop.level(101), "warn");
  for (const name of ["/esc", "/recorder"]) loop.report(status(name), 102.5);
  assert.equal(loop.level(102.5), "stale"); // the lifter says nothing
});

test("after a loop has ended, the next one misses none of its nodes", () => {
  const loop = new Loop(names);
  loop.report(status("/esc"), 100);
  loop.end();
  assert.equal(loop.level(101), "stale");
  assert.deepEqual(
    new Set(loop.rows(101, "live").map((row) => row.judgement.text)),
    new Set(["has ended"]),
  );
  loop.rename({ ...names, controller: null });
  assert.deepEqual(
    loop.rows(200, "live").map((row) => row.judgement.level),
    ["off", "off"],
  );
});

test("with a commander, its dwell points belong to the map and are not held", () => {
  const loop = new Loop(names);
  loop.take("/cost", 1, 1, { step: 1n, r: 2, y_out: 1, settling: false, source: 0, model_id: "" });
  loop.take("/theta", 1, 1, theta(1, true));
  assert.equal(loop.map.bins().mean.length, 0); // held: nothing is explored
  loop.take("/theta", 2, 2, theta(0, true));
  assert.deepEqual(loop.map.bins().mean, [2]);
  assert.equal(loop.now.commanded, true);
  assert.deepEqual(loop.holds, [{ from: 1, to: 1 }]); // what a commander moves is not held
});

test("of several knobs all are kept, and two are a path with the costs of their steps", () => {
  const loop = new Loop(names);
  for (const step of [1, 2, 3]) {
    const cost = { step: BigInt(step), r: 10 * step, settling: false, source: 0, model_id: "" };
    loop.take("/cost", step, step, cost);
    const knobs = Float64Array.of(step, -step, 7);
    if (step !== 2) {
      loop.take("/theta", step, step, { ...theta(1, false), step: BigInt(step), theta: knobs });
    }
  }
  assert.deepEqual(loop.knobs, ["theta[0]", "theta[1]", "theta[2]"]);
  assert.deepEqual(loop.path("theta[1]", "theta[0]", 0, 9), {
    x: [-1, -3],
    y: [1, 3],
    r: [10, 30],
  });
});
