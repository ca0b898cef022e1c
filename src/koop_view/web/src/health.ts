// Is the loop healthy? Judged from what arrived and when, said in words. Pure: time is an argument.

import { shortName } from "./words";

export type Level = "ok" | "warn" | "stale" | "error" | "off";

const URGENCY: Level[] = ["off", "ok", "warn", "stale", "error"];
const REPORT_LATE = 1.8; // [s]: a node reports every second
const LEAST_SILENCE = 1.0; // [s] without a message before a topic counts as silent
export const LEVELS: Level[] = ["ok", "warn", "error", "stale"]; // of diagnostic_msgs/DiagnosticStatus

/** How soon somebody should look: more is sooner. */
export function urgency(level: Level): number {
  return URGENCY.indexOf(level);
}

export function worst(levels: readonly Level[]): Level {
  return levels.reduce((a, b) => (urgency(b) > urgency(a) ? b : a), "off" as Level);
}

/** The newest report of a node. */
export interface Report {
  at: number; // arrival [s]
  level: Level;
  message: string;
  values: Record<string, string>;
}

/** What is known of a topic: when its newest message arrived, and how often they come. */
export interface Heard {
  at: number; // arrival [s]; NaN: none yet
  rate: number; // [1/s] while they came
}

/** Seconds since the newest message if that is too long, else 0. */
export function silence(heard: Heard, now: number): number {
  const age = now - heard.at;
  return age > Math.max(LEAST_SILENCE, 5 / Math.max(heard.rate, 1e-3)) ? age : 0;
}

export type Role = "rig" | "lifter" | "controller" | "other";

export interface Node {
  name: string;
  role: Role;
  report?: Report | undefined;
  output?: Heard | undefined; // the topic that it publishes
  input?: Heard | undefined; // the topic that it answers; none: it needs none
  topic?: string;
}

export interface Judgement {
  level: Level;
  text: string;
}

/** A node of a loop and what is thought of it. */
export interface Row {
  node: Node;
  judgement: Judgement;
}

const OUTPUT = { rig: "state", lifter: "cost", controller: "theta", other: "message" };

/** What a node's row says. `silentFrom` is when the connection was lost, if it was: nobody is blamed for that. */
export function judge(node: Node, now: number): Judgement {
  const { report, output, input } = node;
  const reportAge = report ? now - report.at : NaN;
  const silent = output && Number.isFinite(output.at) ? silence(output, now) : 0;
  const fed = !input || (Number.isFinite(input.at) && silence(input, now) === 0);
  if (report && reportAge > REPORT_LATE) {
    return { level: "stale", text: `no report for ${reportAge.toFixed(1)} s` };
  }
  if (report && inactive(report) && (report.level === "ok" || report.level === "warn")) {
    return { level: "warn", text: `not active: ${report.values["lifecycle_state"]}` };
  }
  if (silent && fed && !(report && report.level === "error")) {
    const ended = report?.message.includes("has ended") ?? false;
    if (!ended) return { level: "stale", text: `no ${OUTPUT[node.role]} for ${silent.toFixed(1)} s` };
  }
  if (report) return { level: report.level, text: report.message || "no findings" };
  if (!output) return { level: "off", text: "nothing heard yet" };
  if (!Number.isFinite(output.at)) return { level: "off", text: `no ${OUTPUT[node.role]} yet` };
  return { level: "ok", text: `sends ${OUTPUT[node.role]}` };
}

function inactive(report: Report | undefined): boolean {
  const state = report?.values["lifecycle_state"];
  return state !== undefined && state !== "active";
}

/** What was lost on a node's inputs, from its report: `12 missed, 1 late`; empty if nothing. */
export function losses(report: Report | undefined): string {
  const said: Record<string, string> = {
    missed_steps: "missed", late: "late", repeated: "repeated", too_old: "too old", unusable: "unusable",
    restarts: "restarts", silences: "silences", late_ticks: "late ticks", lost: "lost", dropped: "dropped",
  };
  const sums = new Map<string, number>();
  for (const [key, value] of Object.entries(report?.values ?? {})) {
    const words = said[key.slice(key.lastIndexOf(" ") + 1)];
    if (words && Number(value) > 0) sums.set(words, (sums.get(words) ?? 0) + Number(value));
  }
  return [...sums].map(([words, n]) => `${n} ${words}`).join(", ");
}

/** Age of the newest input [s] as the node itself measures it. */
export function inputAge(report: Report | undefined): string {
  const ages = Object.entries(report?.values ?? {}).filter(([key]) => key.endsWith(" age_s"));
  const found = ages.map(([, value]) => Number(value)).filter(Number.isFinite);
  return found.length ? `${Math.max(...found).toFixed(3)} s` : "";
}

export interface Situation {
  connection: "open" | "lost" | "connecting";
  lostFor: number; // [s]
  mode: string; // live or recorded
  loop: boolean; // whether there is a loop to look at
  gone: boolean; // whether none of its nodes is left
  about: string; // what whoever started the loop does now
  rows: Row[];
  holding: boolean;
  commanded: boolean; // theta is given by what is no controller
  settling: boolean;
  costUsable: boolean;
  saturated: boolean;
  theta: number;
  limits: [number, number] | undefined;
  r: number;
  rate: number; // steps a second
  reading: number | undefined; // messages read so far of a recording that is not complete
  number: (value: number) => string;
}

/** One line: is my loop healthy? */
export function verdict(s: Situation): Judgement {
  const seconds = `${Math.round(s.lostFor)} s`;
  if (s.connection === "connecting") return { level: "off", text: "Connecting to koop serve…" };
  if (s.connection === "lost") {
    return { level: "error", text: `No connection to koop serve for ${seconds}: what is drawn is old. The loop itself may well go on. Trying again.` };
  }
  const theta = `θ = ${s.number(s.theta)}`;
  if (s.mode === "recorded") {
    if (s.reading !== undefined) return { level: "off", text: `Reading the recording: ${s.reading.toLocaleString("en")} messages so far.` };
    const bad = s.rows.filter((row) => row.judgement.level === "error" || row.judgement.level === "warn");
    const end = bad.length ? ` At its end: ${told(bad)}` : "";
    return { level: "off", text: `A recorded run, complete: it ended with ${theta}, r = ${s.number(s.r)}.${end}` };
  }
  if (!s.loop) return { level: "off", text: "No loop is running yet; the page shows it when there is one." };
  if (s.gone && s.about) return { level: "off", text: `No loop runs in this stage (${s.about}). Last: ${theta}, r = ${s.number(s.r)}.` };
  if (s.gone) return { level: "stale", text: `This loop has gone: none of its nodes is left. Last: ${theta}, r = ${s.number(s.r)}.` };
  const level = worst(s.rows.map((row) => row.judgement.level));
  const guilty = s.rows.filter((row) => row.judgement.level === level);
  const within = s.limits ? ` in [${s.number(s.limits[0])}, ${s.number(s.limits[1])}]` : "";
  const rate = Number.isFinite(s.rate) ? `, ${Math.round(s.rate)} steps a second` : "";
  const figures = `${theta}${within}, r = ${s.number(s.r)}${rate}.`;
  if (level === "error") return { level, text: `Fault: ${told(guilty)}` };
  if (level === "stale") return { level, text: `Not healthy: ${told(guilty)}` };
  if (!Number.isFinite(s.theta)) return { level: "off", text: "Waiting: no θ has come yet." };
  const awaited = (row: Row): boolean => // the controller, which as long as it is not active nobody knows for one
    ((s.holding || s.commanded) && row.node.role === "controller") || (s.commanded && row.node.role === "other" && inactive(row.node.report));
  const others = level === "warn" ? guilty.filter((row) => !awaited(row)) : [];
  const warning = others.length ? ` Warning: ${told(others)}` : "";
  if (s.commanded && s.rate !== 0) {
    return { level: warning ? "warn" : "ok", text: `Open loop: θ is commanded, not sought: ${figures}${warning}` };
  }
  if (s.holding) {
    const why = s.settling ? "until the filters have settled" : s.costUsable ? "as asked" : "because there is no usable cost";
    return { level: "warn", text: `Holding ${why}: ${figures}${warning}` };
  }
  if (s.rate === 0) return { level: "off", text: `At rest: no steps. Last ${theta}, r = ${s.number(s.r)}.` };
  const edge = s.saturated ? " θ is at a limit." : "";
  const fine = !warning && !edge;
  return { level: fine ? "ok" : "warn", text: `${fine ? "Healthy, seeking" : "Seeking"}: ${figures}${edge}${warning}` };
}

function told(rows: Row[]): string {
  const words = rows.map(({ node, judgement }) => `${node.role === "other" ? shortName(node.name) : node.role} – ${judgement.text}`);
  return `${words.join("; ")}.`;
}
