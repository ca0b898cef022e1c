import assert from "node:assert/strict";
import { test } from "node:test";
import { formatKnobs, labels, readKnobs } from "../src/format";

test("theta of a report is shown of one knob and of several", () => {
  assert.equal(formatKnobs(readKnobs("-2.5")), "−2.5");
  assert.equal(formatKnobs(readKnobs("[0.125, -1e-07]")), "(0.125, −1e−7)");
  assert.equal(formatKnobs(readKnobs(undefined)), "–");
});

test("values along an axis can be told apart, of a large one that hardly changes too", () => {
  assert.deepEqual(labels([-0.5, 0, null, 0.5]), ["−0.5", "0", "", "0.5"]);
  assert.deepEqual(labels([101_300, 101_350, 101_400]), ["101300", "101350", "101400"]);
});
