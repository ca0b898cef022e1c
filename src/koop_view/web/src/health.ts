// Is the loop healthy? Judged from what arrived and when, said in words. Pure: time is an argument.

import { formatKnobs, short, shortName } from "./format";

export type Level = "ok" | "warn" | "stale" | "error" | "off";

const URGENCY: Level[] = ["off", "ok", "warn", "stale", "error"];
const REPORT_LATE = 1.8; // [s]: a node reports every second
const LEAST_SILENCE = 1.0; // [s] without a message before a topic counts as silent
/** By the number in diagnostic_msgs/DiagnosticStatus. */
export const LEVELS: Level[] = ["ok", "warn", "error", "stale"];

/** How soon somebody should look: more is sooner. */
export function urgency(level: Level): number {
  return URGENCY.indexOf(level);
}

export function worst(levels: readonly Level[]): Level {
  return levels.reduce((a, b) => (urgency(b) > urgency(a) ? b : a), "off");
}

/** The newest report of a node. */
export interface Report {
  at: number; // arrival [s]
  level: Level;
  message: string;
  values: Record<string, string>;
}

/** When the newest message of a topic arrived, and how often they come. */
export interface Arrival {
  at: number; // [s]; NaN: none yet
  rate: number; // [1/s] while they came
}

/** Seconds since the newest message if that is too long, else 0. */
export function silence(arrival: Arrival, now: number): number {
  const age = now - arrival.at;
  return age > Math.max(LEAST_SILENCE, 5 / Math.max(arrival.rate, 1e-3)) ? age : 0;
}

export type Role = "rig" | "lifter" | "controller" | "other";

export interface LoopNode {
  name: string;
  role: Role;
  report?: Report | undefined;
  output?: Arrival | undefined; // of the topic that it publishes
  input?: Arrival | undefined; // of the topic that it answers; undefined: it needs none
}

export interface Judgement {
  level: Level;
  text: string;
}

/** A node of a loop and its judgement. */
export interface Row {
  node: LoopNode;
  judgement: Judgement;
}

const OUTPUT = { rig: "state", lifter: "cost", controller: "theta", other: "message" };

/** The judgement of a node that is connected. */
export function judge(node: LoopNode, now: number): Judgement {
  const { report, output, input } = node;
  const name = OUTPUT[node.role];
  if (report && now - report.at > REPORT_LATE) {
    return { level: "stale", text: `no report for ${(now - report.at).toFixed(1)} s` };
  }
  if (report && isInactive(report) && (report.level === "ok" || report.level === "warn")) {
    return { level: "warn", text: `not active: ${report.values["lifecycle_state"]}` };
  }
  const hasOutput = output !== undefined && Number.isFinite(output.at);
  const silent = hasOutput ? silence(output, now) : 0;
  const hasInput = !input || (Number.isFinite(input.at) && silence(input, now) === 0);
  const isExcused = report && (report.level === "error" || report.message.includes("has ended"));
  if (silent && hasInput && !isExcused) {
    return { level: "stale", text: `no ${name} for ${silent.toFixed(1)} s` };
  }
  if (report) return { level: report.level, text: report.message || "nothing to report" };
  if (hasOutput) return { level: "ok", text: `publishes ${name}` };
  return { level: "off", text: output ? `no ${name} yet` : "no message yet" };
}

function isInactive(report: Report | undefined): boolean {
  const state = report?.values["lifecycle_state"];
  return state !== undefined && state !== "active";
}

const LOSSES =
  "missed_steps late repeated too_old unusable restarts silences late_ticks lost dropped".split(
    " ",
  );

/** What a node has lost on its inputs, by its report: `12 missed, 1 late`; empty if nothing. */
export function losses(report: Report | undefined): string {
  const sums = new Map<string, number>();
  for (const [key, value] of Object.entries(report?.values ?? {})) {
    const name = key.slice(key.lastIndexOf(" ") + 1);
    if (LOSSES.includes(name)) sums.set(name, (sums.get(name) ?? 0) + Number(value));
  }
  const lost = [...sums].filter(([, n]) => n > 0);
  return lost.map(([name, n]) => `${n} ${name.replace("_steps", "").replace("_", " ")}`).join(", ");
}

/** Age of the newest input [s] as the node itself measures it. */
export function inputAge(report: Report | undefined): string {
  const values = Object.entries(report?.values ?? {});
  const ages = values.filter(([key]) => key.endsWith(" age_s")).map(([, value]) => Number(value));
  const finite = ages.filter(Number.isFinite);
  return finite.length ? `${Math.max(...finite).toFixed(3)} s` : "";
}

/** What the newest messages of a loop say. */
export interface LoopState {
  ended: boolean; // none of its nodes is left
  holding: boolean;
  commanded: boolean; // theta comes from a commander, which has no relay
  settling: boolean;
  saturated: boolean;
  theta: readonly number[]; // of each knob; empty: none has come
  r: number;
}

export interface Situation {
  connection: "open" | "lost" | "connecting";
  lostFor: number; // [s]
  recorded: boolean;
  read: number | undefined; // messages so far of a recording that is not complete
  about: string; // what the command that runs the loop does now
  rows: readonly Row[];
  limits: readonly [number, number][]; // of theta, of each knob; empty: not known
  rate: number; // steps per second; NaN: not known yet
  loop: LoopState | undefined;
}

const NO_LOOP = "This recording holds no loop. Foxglove and Lichtblick show its topics.";

/** One line: is my loop healthy? */
export function verdict(s: Situation): Judgement {
  const { loop } = s;
  const last = `θ = ${formatKnobs(loop?.theta)}, r = ${short(loop?.r)}.`;
  if (s.connection === "connecting") return { level: "off", text: "Connecting to koop serve…" };
  if (s.connection === "lost") {
    const text =
      `No connection to koop serve for ${Math.round(s.lostFor)} s. The figures are old; ` +
      "the loop may still be running. Reconnecting.";
    return { level: "error", text };
  }
  if (s.recorded && !loop) return { level: "off", text: NO_LOOP };
  if (s.recorded) return { level: "off", text: describeRecording(s, last) };
  if (!loop) return { level: "off", text: "No loop is running yet. It is shown once it runs." };
  if (loop.ended && s.about) {
    return { level: "off", text: `No loop runs in this stage (${s.about}). Last: ${last}` };
  }
  if (loop.ended) {
    return {
      level: "stale",
      text: `This loop has ended: none of its nodes is left. Last: ${last}`,
    };
  }
  const level = worst(s.rows.map((row) => row.judgement.level));
  const causes = s.rows.filter((row) => row.judgement.level === level);
  if (level === "error") return { level, text: `Fault: ${describe(causes)}` };
  if (level === "stale") return { level, text: `Not healthy: ${describe(causes)}` };
  if (!loop.theta.length) return { level: "off", text: "Waiting: no θ has come yet." };
  const others = level === "warn" ? causes.filter((row) => !isExpected(row, loop)) : [];
  return describeRun(s, loop, others.length ? ` Warning: ${describe(others)}` : "", last);
}

function describeRecording(s: Situation, last: string): string {
  if (s.read !== undefined) {
    return `Reading the recording: ${s.read.toLocaleString("en")} messages so far.`;
  }
  const bad = s.rows.filter(({ judgement: { level } }) => level === "error" || level === "warn");
  const end = bad.length ? ` At its end: ${describe(bad)}` : "";
  return `A recorded run, complete: it ended with ${last}${end}`;
}

/** Whether a warning says nothing new: a controller that holds, or is not active yet. */
function isExpected({ node }: Row, loop: LoopState): boolean {
  if (node.role === "controller") return loop.holding || loop.commanded;
  // a controller that was never active has published nothing that shows its role
  return loop.commanded && node.role === "other" && isInactive(node.report);
}

/** What a loop does that works, with a warning if there is one. */
function describeRun(
  { limits, rate }: Situation,
  loop: LoopState,
  warning: string,
  last: string,
): Judgement {
  const steps = Number.isFinite(rate) ? `, ${Math.round(rate)} steps per second` : "";
  const figures = `θ = ${formatKnobs(loop.theta, limits)}, r = ${short(loop.r)}${steps}.`;
  if (loop.commanded && rate !== 0) {
    const text = `Open loop: θ is commanded, not sought: ${figures}${warning}`;
    return { level: warning ? "warn" : "ok", text };
  }
  if (loop.holding) {
    const hasCost = Number.isFinite(loop.r);
    const why = hasCost ? "as requested" : "because there is no usable cost";
    const reason = loop.settling ? "until the filters have settled" : why;
    return { level: "warn", text: `Holding ${reason}: ${figures}${warning}` };
  }
  if (rate === 0) return { level: "off", text: `At rest: no steps. Last: ${last}` };
  if (loop.saturated) {
    return { level: "warn", text: `Seeking: ${figures} θ is at a limit.${warning}` };
  }
  if (warning) return { level: "warn", text: `Seeking: ${figures}${warning}` };
  return { level: "ok", text: `Healthy, seeking: ${figures}` };
}

function describe(rows: readonly Row[]): string {
  const words = rows.map(({ node, judgement }) => {
    const name = node.role === "other" ? shortName(node.name) : node.role;
    return `${name} – ${judgement.text}`;
  });
  return `${words.join("; ")}.`;
}
