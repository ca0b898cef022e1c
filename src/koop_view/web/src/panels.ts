// The parts of the page that are words: health, loops, what is in force.

import { byId, make, setChildren, setOptions, setText } from "./dom";
import { short, shortName } from "./format";
import { inputAge, type Level, losses, type Row, silence, urgency } from "./health";
import { costName, type Loop } from "./loop";
import type { Desk } from "./operator";
import type { TimeAxis } from "./time_axis";

export const WORDS = { ok: "OK", warn: "WARN", error: "ERROR", stale: "STALE", off: "–" };

/** The parameters that are shown, with their units. */
export const PARAMETERS = {
  controller: {
    law: "",
    objective: "",
    theta_min: "",
    theta_max: "",
    theta_initial: "",
    theta_scale: "",
    step_size: "",
    dwell: "s",
    tau_f: "s",
    rate_limit: "1/s",
  },
  lifter: { cost: "", model: "", omega_h: "rad/s", omega_l: "rad/s", dt: "s" },
};

export function showSpans(time: TimeAxis): void {
  for (const button of document.querySelectorAll<HTMLButtonElement>("#spans button")) {
    const isPressed = !time.part && Number(button.value) === time.span;
    button.setAttribute("aria-pressed", String(isPressed));
  }
  byId("zoomed").hidden = !time.part;
}

/** Each loop with its level in the selector, and those that need somebody beside it. */
export function showLoops(
  loops: ReadonlyMap<string, Loop>,
  levels: ReadonlyMap<string, Level>,
  chosen: string,
): void {
  const describe = (namespace: string): string => {
    const name = namespace === "/" ? "/ (no namespace)" : namespace;
    const level = levels.get(namespace) ?? "off";
    if (level === "off") return name;
    return `${name}: ${loops.get(namespace)?.now.ended ? "ENDED" : WORDS[level]}`;
  };
  const names = [...loops.keys()].sort();
  const select = byId<HTMLSelectElement>("loop");
  byId("loop-label").hidden = names.length < 2;
  setOptions(select, names);
  for (const option of select.options) setText(option, describe(option.value));
  select.value = chosen;
  const isBad = (name: string): boolean => urgency(levels.get(name) ?? "off") > urgency("ok");
  const bad = names.length > 1 ? names.filter(isBad) : [];
  setText(byId("fleet"), bad.map(describe).join(", "));
}

/** A line for each node. */
export function showHealth(rows: readonly Row[], recorded: boolean, now: number): void {
  const lines = rows.map((row) => healthLine(row, recorded, now));
  setChildren(byId("health"), lines);
}

function healthLine({ node, judgement }: Row, recorded: boolean, now: number): HTMLElement {
  const { output } = node;
  const silent = output && !recorded ? silence(output, now) : 0;
  const age = silent ? `${silent.toFixed(1)} s` : inputAge(node.report);
  let rate = silent ? 0 : (output?.rate ?? NaN);
  if (!Number.isFinite(output?.at)) rate = Number(node.report?.values["rate_hz"] ?? NaN);
  const rateText = Number.isFinite(rate) ? `${rate.toFixed(rate < 10 ? 1 : 0)} /s` : "";
  const lost = losses(node.report);
  return make(
    "li",
    { data: { node: node.name, level: judgement.level } },
    make("span", { class: "mark", text: WORDS[judgement.level] }),
    make("b", { text: shortName(node.name), title: node.name }),
    make("span", { class: "figure", text: rateText, title: "messages per second" }),
    make("span", {
      class: "figure",
      text: age && !recorded ? `age ${age}` : "",
      title: "age of the newest input",
    }),
    make("span", { class: "says", text: judgement.text }),
    make("span", { class: "lost", text: lost && `since its start: ${lost}` }),
  );
}

/** Cost, model and parameters that are in force. */
export function showForce(desk: Desk): void {
  const { loop } = desk;
  const isSought = loop !== undefined && !loop.now.commanded;
  const finite = (value: number | undefined): string =>
    isSought && Number.isFinite(value) ? short(value) : "";
  const step = loop?.state.lastStep ?? -1;
  const file = String(desk.parameter("lifter.model") ?? "").replace(/^.*\//, "");
  const cost = costName(loop?.source ?? -1) || String(desk.parameter("lifter.cost") ?? "");
  const pairs: [string, string][] = [
    ["cost", `${cost}${loop?.now.settling ? " (settling)" : ""}`],
    ["model", [loop?.modelId, file].filter(Boolean).join(" – ")],
    ["step", step >= 0 ? step.toLocaleString("en") : ""],
    ["slope dr/dθ", finite(loop?.gradient)],
    ["confidence", finite(loop?.confidence)],
    ["swing", loop?.swing === 1 ? "" : finite(loop?.swing)],
  ];
  for (const [role, units] of Object.entries(PARAMETERS)) {
    for (const [key, unit] of Object.entries(units)) {
      const value = desk.parameter(`${role}.${key}`);
      if (value === undefined || key === "cost" || key === "model") continue;
      const values = Array.isArray(value) ? value : [value];
      const isNumber = values.every((v) => typeof v === "number");
      const text = isNumber ? `${values.map(short).join(", ")} ${unit}` : String(value);
      pairs.push([key, key === "rate_limit" && value === 0 ? "none" : text]);
    }
  }
  const items = pairs.filter(([, text]) => text);
  const rows = items.map(([key, text]) => [make("dt", { text: key }), make("dd", { text })]);
  setChildren(byId("force"), rows.flat());
}
