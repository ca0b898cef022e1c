import assert from "node:assert/strict";
import { test } from "node:test";
import { formatKnobs, readKnobs } from "../src/format";

test("theta of a report is shown of one knob and of several", () => {
  assert.equal(formatKnobs(readKnobs("-2.5")), "−2.5");
  assert.equal(formatKnobs(readKnobs("[0.125, -1e-07]")), "(0.125, −1e−7)");
  assert.equal(formatKnobs(readKnobs(undefined)), "–");
});
