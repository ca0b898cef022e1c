import assert from "node:assert/strict";
import { test } from "node:test";
import {
  inputAge,
  judge,
  type LoopNode,
  losses,
  type Report,
  type Situation,
  verdict,
} from "../src/health";

const report = (at: number, more: Partial<Report> = {}): Report => ({
  at,
  level: "ok",
  message: "lifting",
  values: { lifecycle_state: "active" },
  ...more,
});
const lifter = (more: Partial<LoopNode> = {}): LoopNode => ({
  name: "/koopman_lifter",
  role: "lifter",
  report: report(99.5),
  output: { at: 99.99, rate: 200 },
  input: { at: 99.99, rate: 200 },
  ...more,
});

test("a node that reports and answers is what it says it is", () => {
  assert.deepEqual(judge(lifter(), 100), { level: "ok", text: "lifting" });
  const broken = lifter({
    report: report(99.5, { level: "error", message: "2 publishers on 'state'" }),
  });
  assert.deepEqual(judge(broken, 100), { level: "error", text: "2 publishers on 'state'" });
});

test("a killed lifter is stale within two seconds, whenever it had last reported", () => {
  for (const last of [99.01, 99.5, 99.99]) {
    const killed = lifter({
      report: report(last),
      output: { at: 100, rate: 200 },
      input: { at: 102, rate: 200 },
    });
    assert.equal(judge(killed, 102).level, "stale");
    assert.equal(judge(killed, 100.5).level, "ok");
  }
});

test("a node without input is not blamed for missing output", () => {
  const starved = lifter({
    report: report(102),
    output: { at: 100, rate: 200 },
    input: { at: 100, rate: 200 },
  });
  assert.equal(judge(starved, 102.5).level, "ok");
  const deaf = lifter({
    report: report(102),
    output: { at: 100, rate: 200 },
    input: { at: 102.4, rate: 200 },
  });
  assert.deepEqual(judge(deaf, 102.5), { level: "stale", text: "no cost for 2.5 s" });
});

test("a node that is slow by nature is not silent between two messages", () => {
  const slow: LoopNode = { name: "rig", role: "rig", output: { at: 97, rate: 0.5 } };
  assert.equal(judge(slow, 100).level, "ok");
  assert.equal(judge(slow, 108).level, "stale");
});

test("a rig without diagnostics is judged by its state", () => {
  assert.deepEqual(judge({ name: "/state", role: "rig", output: { at: 99.9, rate: 200 } }, 100), {
    level: "ok",
    text: "publishes state",
  });
  assert.deepEqual(judge({ name: "/state", role: "rig", output: { at: NaN, rate: 0 } }, 100), {
    level: "off",
    text: "no state yet",
  });
});

test("an inactive node is said to be", () => {
  const inactive = lifter({ report: report(99.5, { values: { lifecycle_state: "inactive" } }) });
  assert.deepEqual(judge(inactive, 100), { level: "warn", text: "not active: inactive" });
});

test("losses are added up over the inputs, ages are the oldest", () => {
  const values = {
    "state missed_steps": "3",
    "cost missed_steps": "2",
    "cost late": "0",
    "cost too_old": "1",
    "state age_s": "0.004",
    "cost age_s": "nan",
  };
  assert.equal(losses(report(0, { values })), "5 missed, 1 too old");
  assert.equal(inputAge(report(0, { values })), "0.004 s");
});

const seeking = {
  ended: false,
  holding: false,
  commanded: false,
  settling: false,
  saturated: false,
  theta: [-2.5],
  r: 0.01,
};
const healthy: Situation = {
  connection: "open",
  lostFor: 0,
  recorded: false,
  read: undefined,
  about: "",
  rows: [{ node: lifter(), judgement: { level: "ok", text: "lifting" } }],
  limits: [[-5, 5]],
  rate: 200,
  loop: seeking,
};

test("the verdict names what comes first", () => {
  assert.deepEqual(verdict(healthy), {
    level: "ok",
    text: "Healthy, seeking: θ = −2.5 in [−5, 5], r = 0.01, 200 steps per second.",
  });
  const two = { ...seeking, theta: [-2.5, 1] };
  const limits: Situation["limits"] = [...healthy.limits, [0, 2]];
  assert.match(
    verdict({ ...healthy, limits, loop: two }).text,
    /: θ = \(−2.5 in \[−5, 5\], 1 in \[0, 2\]\), r/,
  );
  const stale = {
    ...healthy,
    rows: [
      ...healthy.rows,
      { node: lifter(), judgement: { level: "stale" as const, text: "no cost for 2.0 s" } },
    ],
  };
  assert.deepEqual(verdict(stale), {
    level: "stale",
    text: "Not healthy: lifter – no cost for 2.0 s.",
  });
  const fault = {
    ...stale,
    rows: [
      ...stale.rows,
      { node: lifter({ role: "rig" }), judgement: { level: "error" as const, text: "diverged" } },
    ],
  };
  assert.deepEqual(verdict(fault), { level: "error", text: "Fault: rig – diverged." });
  assert.match(
    verdict({ ...fault, connection: "lost", lostFor: 3 }).text,
    /^No connection to koop serve for 3 s/,
  );
  assert.match(
    verdict({ ...fault, loop: { ...seeking, ended: true } }).text,
    /^This loop has ended: none of its nodes is left/,
  );
  assert.equal(
    verdict({ ...fault, loop: { ...seeking, ended: true }, about: "commissioning: tune, round 1" })
      .level,
    "off",
  );
  assert.doesNotMatch(verdict({ ...healthy, rate: NaN }).text, /steps|rest/); // not known yet
  assert.match(verdict({ ...healthy, loop: undefined, rows: [] }).text, /^No loop is running/);
});

test("a hold says why", () => {
  const held = {
    ...healthy,
    loop: { ...seeking, holding: true },
    rows: [
      {
        node: lifter({ role: "controller" as const }),
        judgement: { level: "warn" as const, text: "holding theta" },
      },
    ],
  };
  assert.match(verdict(held).text, /^Holding as requested: θ = −2.5/);
  assert.doesNotMatch(verdict(held).text, /Warning/); // that it holds is said once
  assert.match(
    verdict({ ...held, loop: { ...held.loop, r: NaN } }).text,
    /^Holding because there is no usable cost: /,
  );
  assert.match(
    verdict({ ...held, loop: { ...held.loop, settling: true } }).text,
    /^Holding until the filters have settled: /,
  );
  assert.equal(verdict(held).level, "warn");
});

test("a warning does not hide what the controller does", () => {
  const rig = {
    node: lifter({ role: "rig" as const }),
    judgement: { level: "warn" as const, text: "27 late ticks" },
  };
  assert.deepEqual(verdict({ ...healthy, rows: [...healthy.rows, rig] }), {
    level: "warn",
    text: "Seeking: θ = −2.5 in [−5, 5], r = 0.01, 200 steps per second. Warning: rig – 27 late ticks.",
  });
  assert.match(
    verdict({ ...healthy, rows: [rig], loop: { ...seeking, holding: true } }).text,
    /^Holding as requested: .* Warning: rig – 27 late ticks\.$/,
  );
  assert.deepEqual(verdict({ ...healthy, loop: { ...seeking, saturated: true } }).level, "warn");
});

test("a commanded theta is neither sought nor held", () => {
  const waiting = {
    node: lifter({ role: "controller" as const }),
    judgement: { level: "warn" as const, text: "not active: inactive" },
  };
  const commanded = { ...healthy, loop: { ...seeking, commanded: true, holding: true } };
  assert.deepEqual(verdict({ ...commanded, rows: [waiting] }), {
    level: "ok",
    text: "Open loop: θ is commanded, not sought: θ = −2.5 in [−5, 5], r = 0.01, 200 steps per second.",
  });
  const report = {
    at: 10,
    level: "ok" as const,
    message: "",
    values: { lifecycle_state: "inactive" },
  };
  const unknown = {
    node: lifter({ name: "/esc", role: "other" as const, report }),
    judgement: waiting.judgement,
  }; // it has published nothing yet
  assert.equal(verdict({ ...commanded, rows: [unknown] }).level, "ok");
  assert.equal(verdict({ ...healthy, rows: [unknown] }).level, "warn");
  assert.match(
    verdict({ ...commanded, loop: { ...seeking, commanded: true }, rate: 0 }).text,
    /^At rest/,
  );
});

test("a recording without a loop is not waited for", () => {
  const other = { ...healthy, recorded: true, read: 0, loop: undefined, rows: [] };
  assert.match(verdict(other).text, /^This recording holds no loop/);
  assert.match(verdict({ ...other, loop: seeking }).text, /^Reading the recording: 0 messages/);
});
