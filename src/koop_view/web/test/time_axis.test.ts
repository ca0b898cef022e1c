import assert from "node:assert/strict";
import { test } from "node:test";
import { TimeAxis } from "../src/time_axis";

test("a recording of a tenth of a second fills its axis, and each tick says where it is", () => {
  const time = new TimeAxis(
    () => 0,
    () => 0.1,
  );
  time.recorded = true;
  time.follow(0);
  assert.deepEqual(time.range(), [0, 0.1]);
  assert.equal(time.tick(0.025), "0.025 s");
});
