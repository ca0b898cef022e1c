// The operator's page: what comes over the link goes into loops, what is in the chosen loop onto the page.

import type { ParameterValue } from "@foxglove/ws-protocol";
import { Figures, type Limits } from "./figures";
import { inputAge, losses, silence, urgency, verdict, worst, type Judgement, type Level, type Node } from "./health";
import { Link, type ServerState } from "./link";
import { Loop, sourceName, type Status } from "./loop";
import { Operate } from "./operate";
import { View } from "./view";
import { byId, clock, make, say, short, shortName } from "./words";

const MOST_NOTES = 40;
const FRAME = 75; // [ms] between two looks at what is to be drawn
const SLOW = 250; // [ms] between two looks at health and words
const ASK_AGAIN = 3; // [s]
const DISCOVERY = 4; // [s] that a server which has just begun may need to find the loops
const MOST_BAD = 3; // loops of a fleet that are named beside the selector
const TOKEN = "koop token"; // in the storage of the tab
const WARNING = 30; // rcl_interfaces/msg/Log
const WATCHED = {
  controller: ["law", "objective", "theta_min", "theta_max", "theta_initial", "theta_scale", "step_size", "dwell", "tau_f", "rate_limit", "dt"],
  lifter: ["cost", "model", "omega_h", "omega_l", "dt"],
};
const UNITS: Record<string, string> = { dwell: "s", tau_f: "s", omega_h: "rad/s", omega_l: "rad/s", dt: "s", rate_limit: "1/s" };

const seconds = (): number => performance.now() / 1000;

const loops = new Map<string, Loop>();
const parameters = new Map<string, ParameterValue>();
const counts = new Map<string, number>();
let chosen = decodeURIComponent(/[#&]loop=([^&]*)/.exec(location.hash)?.[1] ?? "");
let server: ServerState | undefined;
let connection: "open" | "lost" | "connecting" = "connecting";
let lostAt = seconds();
let openedAt = NaN;
let newest = NaN; // receive time of the newest message [s]
let newestAt = NaN; // when it came, on the page's clock [s]
let complete = false;
let watchedNames = "";
let askedAt = 0;

const loop = (): Loop | undefined => loops.get(chosen);
const recorded = (): boolean => server?.mode === "recorded";

function nowOfServer(): number {
  if (recorded()) return lastTime(); // later there are only reports
  if (connection !== "open") return newest;
  return newest + Math.max(0, seconds() - newestAt);
}

function firstTime(): number {
  const l = loop();
  return l ? Math.min(...[l.state, l.cost, l.theta].map((s) => s.first).filter(Number.isFinite)) : NaN;
}

function lastTime(): number {
  const l = loop();
  return l ? Math.max(...[l.state, l.cost, l.theta].map((s) => s.last).filter(Number.isFinite)) : NaN;
}

function parameter(name: string): ParameterValue {
  const [role, key] = name.split(".") as ["controller" | "lifter", string];
  const node = loop()?.names[role];
  return node ? parameters.get(`${node}.${key}`) : undefined;
}

function limits(): Limits | undefined {
  const [low, high] = [parameter("controller.theta_min"), parameter("controller.theta_max")];
  return typeof low === "number" && typeof high === "number" ? { low, high } : undefined;
}

function dt(): number {
  const given = parameter("lifter.dt") ?? parameter("controller.dt");
  if (typeof given === "number" && given > 0) return given;
  const state = loop()?.state;
  return state && state.count > 1 ? 1 / Math.max(state.rate(state.last, 10), 1e-9) : NaN;
}

// -- the link ---------------------------------------------------------------------------------

const token = takeToken();
const view = new View(firstTime, nowOfServer);
const figures = new Figures({ loop, limits, dt }, view);
view.changed = () => {
  figures.redraw();
  showSpans();
};

const link = new Link({
  opened() {
    connection = "open";
    openedAt = seconds();
    watchedNames = "";
  },
  closed() {
    if (connection === "open") lostAt = seconds();
    connection = connection === "connecting" && loops.size === 0 && seconds() - lostAt < 2 ? "connecting" : "lost";
  },
  server: takeServer,
  message(topic, time, message) {
    const now = seconds();
    counts.set(topic, (counts.get(topic) ?? 0) + 1);
    if (!(time < newest - 5) || time > newest) {
      newest = Number.isNaN(newest) ? time : Math.max(newest, time);
      newestAt = now;
    }
    if (time < newest - 5) newest = time; // the clock was set back
    if (topic === "/diagnostics") takeDiagnostics(message, now);
    else if (topic === "/rosout") takeLog(message, time);
    else loop()?.take(topic, time, now, message);
  },
  parameters(values) {
    for (const [name, value] of values) parameters.set(name, value);
    figures.redraw();
  },
  complete() {
    complete = true;
    figures.redraw();
  },
  note: (text) => note(text, Date.now() / 1000, "warn"),
  tokenRefused() {
    sessionStorage.removeItem(TOKEN);
    note("Read-only: the token is not this server's; it has perhaps been restarted. Open the address that it has printed.", Date.now() / 1000, "error");
  },
  services: () => operate.refresh(),
}, token);

const operate = new Operate({ loop, link, operate: () => server?.operate ?? false, parameter });

/** The token of the address, kept for a reload and taken out of what others may see. */
function takeToken(): string {
  const found = /[#&]token=([^&]*)/.exec(location.hash)?.[1];
  if (found) {
    sessionStorage.setItem(TOKEN, decodeURIComponent(found));
    history.replaceState(null, "", location.pathname + location.search + (chosen ? `#loop=${encodeURIComponent(chosen)}` : ""));
  }
  return sessionStorage.getItem(TOKEN) ?? "";
}

function takeServer(state: ServerState): void {
  const other = server && (server.mode !== state.mode || (state.mode === "recorded" && server.session !== state.session));
  if (other) {
    loops.clear();
    newest = NaN;
  }
  if (recordedAgain(state)) for (const l of loops.values()) l.clear();
  server = state;
  if (state.mode === "recorded" && !view.recorded) {
    view.recorded = true;
    view.follow(0);
  }
  for (const names of state.loops) {
    const known = loops.get(names.namespace);
    if (known) known.rename(names);
    else loops.set(names.namespace, new Loop(names));
  }
  if (!loops.has(chosen)) chosen = [...loops.keys()][0] ?? chosen;
  showLoops();
  listen();
  operate.refresh();
}

/** A recording is sent whole after every connection: what was read before would be there twice. */
function recordedAgain(state: ServerState): boolean {
  const again = state.mode === "recorded" && watchedNames === "";
  if (again) complete = false;
  return again;
}

function listen(): void {
  link.want([...(loop()?.topics ?? []), "/diagnostics", "/rosout"]);
  const names = (["controller", "lifter"] as const).flatMap((role) => {
    const node = loop()?.names[role];
    return node ? WATCHED[role].map((key) => `${node}.${key}`) : [];
  });
  if (names.join() === watchedNames) return;
  watchedNames = names.join();
  link.watch(names);
}

function choose(namespace: string): void {
  chosen = namespace;
  showLoops();
  history.replaceState(null, "", `#loop=${encodeURIComponent(namespace)}`);
  if (recorded()) for (const l of loops.values()) l.clear();
  complete = false;
  listen();
  operate.forget();
  figures.rebuild();
  slow();
}

function takeDiagnostics(message: Record<string, unknown>, now: number): void {
  type Raw = { level: number; name: string; message: string; hardware_id: string; values: { key: string; value: string }[] };
  for (const raw of message["status"] as Raw[]) {
    const status: Status = {
      name: raw.name, level: raw.level, message: raw.message, hardware: raw.hardware_id,
      values: Object.fromEntries(raw.values.map(({ key, value }) => [key, value])),
    };
    for (const l of loops.values()) if (ownerOf(status) === l) l.report(status, now);
  }
}

/** The loop that a report is about: by its namespace, the longest that fits. */
function ownerOf(status: Status): Loop | undefined {
  const fits = [...loops.values()].filter(({ names }) => {
    if ([names.plant, names.lifter, names.controller].includes(status.name)) return true;
    return status.hardware === `koop${names.namespace}`.replace(/\/$/, "");
  });
  return fits.sort((a, b) => b.names.namespace.length - a.names.namespace.length)[0];
}

function takeLog(message: Record<string, unknown>, time: number): void {
  const level = message["level"] as number;
  if (level >= WARNING) note(`${message["name"] as string}: ${message["msg"] as string}`, time, level > WARNING ? "error" : "warn");
}

function note(text: string, time: number, level: string): void {
  const notes = byId("notes"), top = notes.firstElementChild as HTMLElement | null;
  if (top?.dataset["text"] === text) { // said again
    const times = Number(top.dataset["times"] ?? 1) + 1;
    top.dataset["times"] = String(times);
    say(top.firstElementChild as HTMLElement, `${clock(time)} ×${times} `);
    return;
  }
  notes.prepend(make("li", { data: { level, text } }, make("small", { text: `${clock(time)} ` }), make("span", { text })));
  while (notes.children.length > MOST_NOTES) notes.lastElementChild?.remove();
}

// -- the page ---------------------------------------------------------------------------------

function showLoops(): void {
  const select = byId<HTMLSelectElement>("loop"), names = [...loops.keys()].sort();
  byId("loop-label").hidden = names.length < 2;
  if (names.join() !== [...select.options].map((o) => o.value).join()) {
    select.replaceChildren(...names.map((name) => {
      const option = make("option") as HTMLOptionElement;
      option.value = name;
      return option;
    }));
  }
  if (select.value !== chosen) select.value = chosen;
}

/** How each loop of a fleet does: a word in the selector, and those that need somebody beside it. */
function showFleet(levels: Map<string, Level>): void {
  const name = (namespace: string): string => (namespace === "/" ? "/ (no namespace)" : namespace);
  const word = (namespace: string, level: Level): string => (loops.get(namespace)?.gone ? "GONE" : WORDS[level]);
  for (const option of byId<HTMLSelectElement>("loop").options) {
    const level = recorded() || connection !== "open" ? "off" : levels.get(option.value) ?? "off";
    say(option, level === "off" ? name(option.value) : `${name(option.value)}: ${word(option.value, level)}`);
  }
  const bad = loops.size < 2 || recorded() || connection !== "open" ? [] : [...levels].filter(([, level]) => urgency(level) > urgency("ok"));
  bad.sort(([a, x], [b, y]) => urgency(y) - urgency(x) || a.localeCompare(b));
  const shown = bad.slice(0, MOST_BAD).map(([namespace, level]) => ({ namespace, level, text: `${name(namespace)}: ${word(namespace, level)}` }));
  const more = bad.length > shown.length ? `and ${bad.length - shown.length} more of ${loops.size}` : "";
  const text = JSON.stringify([shown, more]);
  if (text === fleetShown) return;
  fleetShown = text;
  byId("fleet").replaceChildren(...shown.map(({ namespace, level, text }) => {
    const button = make("button", { text, title: "show this loop", data: { loop: namespace, level } });
    button.addEventListener("click", () => choose(namespace));
    return button;
  }), ...(more ? [make("span", { class: "soft", text: more })] : []));
}

let fleetShown = "";

function showSpans(): void {
  for (const button of document.querySelectorAll<HTMLButtonElement>("#spans button")) {
    button.setAttribute("aria-pressed", String(!view.zoomed && Number(button.value) === view.span));
  }
  byId("zoomed").hidden = !view.zoomed;
}

const WORDS = { ok: "OK", warn: "WARN", error: "ERROR", stale: "STALE", off: "–" };

function healthRow(node: Node, judgement: Judgement, now: number): HTMLElement {
  const heard = loop()?.hears(node.role);
  const own = node.report?.values["rate_hz"];
  const quiet = heard && silence(heard, now) > 0;
  const rate = recorded() ? loop()?.meanRate(node.role) ?? "" : heard && Number.isFinite(heard.at) ? (quiet ? "0" : heard.rate.toFixed(heard.rate < 10 ? 1 : 0)) : own ?? "";
  const age = recorded() ? "" : quiet ? `${(now - heard.at).toFixed(1)} s` : inputAge(node.report);
  const lost = losses(node.report);
  const figure = (text: string, title: string): HTMLElement => make("span", { class: "figure", text, title });
  return make("li", { data: { node: node.name, level: judgement.level } },
    make("span", { class: "mark", text: WORDS[judgement.level] }), make("b", { text: shortName(node.name), title: node.name }),
    figure(rate && `${rate} /s`, "messages a second"), figure(age && `age ${age}`, "age of the newest input"),
    make("span", { class: "says", text: judgement.text }), make("span", { class: "lost", text: lost && `since its start: ${lost}` }));
}

let rowsShown = "";

function showHealth(rows: { node: Node; judgement: Judgement }[], now: number): void {
  const fresh = rows.map(({ node, judgement }) => healthRow(node, judgement, now));
  const text = fresh.map((row) => row.outerHTML).join("");
  if (text === rowsShown) return;
  rowsShown = text;
  byId("health").replaceChildren(...fresh);
}

let forceShown = "";

function showForce(): void {
  const l = loop();
  const value = (name: string): string => {
    const found = parameter(name), unit = UNITS[name.slice(name.indexOf(".") + 1)];
    if (found === undefined) return "";
    return (typeof found === "number" ? short(found) : String(found)) + (unit ? ` ${unit}` : "");
  };
  const pairs: [string, string][] = [
    ["cost", [sourceName(l?.source ?? -1) || value("lifter.cost"), l?.settling ? "(settling)" : ""].join(" ").trim()],
    ["model", [l?.modelId ?? "", value("lifter.model").replace(/^.*\//, "")].filter(Boolean).join(" – ")],
    ["law", [value("controller.law"), value("controller.objective")].filter(Boolean).join(", ")],
    ["θ limits", limits() ? `[${short(limits()!.low)}, ${short(limits()!.high)}]` : ""],
    ["θ initial", value("controller.theta_initial")],
    ["θ scale", value("controller.theta_scale")],
    ["step k", [value("controller.step_size"), l && !l.commanded && Number.isFinite(l.swing) && l.swing !== 1 ? `× ${short(l.swing)} now` : ""].join(" ").trim()],
    ["dwell", value("controller.dwell")],
    ["τ_f", value("controller.tau_f")],
    ["rate limit", parameter("controller.rate_limit") === 0 ? "none" : value("controller.rate_limit")],
    ["ω_h, ω_l", [value("lifter.omega_h"), value("lifter.omega_l")].filter(Boolean).join(", ")],
    ["Δt", value("lifter.dt") || value("controller.dt")],
    ["slope dr/dθ", l && !l.commanded && Number.isFinite(l.gradient) ? short(l.gradient) : ""],
    ["confidence", l && !l.commanded && Number.isFinite(l.confidence) ? short(l.confidence) : ""],
    ["stamps", l && l.stamp === 0 ? "none: the rig sets no header stamp" : ""],
    ["step", l && l.state.lastStep >= 0 ? l.state.lastStep.toLocaleString("en") : ""],
  ];
  const text = JSON.stringify(pairs);
  if (text === forceShown) return;
  forceShown = text;
  byId("force").replaceChildren(...pairs.filter(([, v]) => v).flatMap(([key, v]) => [make("dt", { text: key }), make("dd", { text: v })]));
}

/** Ask again for parameters of nodes that did not answer yet: one that has just come is not ready at once. */
function askAgain(now: number): void {
  const missing = parameter("controller.theta_min") === undefined || parameter("lifter.cost") === undefined;
  if (!missing || now - askedAt < ASK_AGAIN || !loop()) return;
  askedAt = now;
  link.refresh();
}

/** All that is words. */
function slow(): void {
  const now = seconds(), l = loop();
  if (connection === "open" && now - openedAt > DISCOVERY) {
    for (const [namespace, other] of loops) if (!server?.loops.some((names) => names.namespace === namespace)) other.end();
  }
  const rows = l?.rows(now, recorded() ? "recorded" : connection === "open" ? "live" : "unknown") ?? [];
  const bounds = limits(), about = server?.about ?? "";
  const found = verdict({
    connection, lostFor: now - lostAt, mode: server?.mode ?? "live", loop: l !== undefined, gone: l?.gone ?? false, about, rows, holding: l?.holding ?? false, commanded: l?.commanded ?? false,
    settling: l?.settling ?? false, costUsable: Number.isFinite(l?.r ?? NaN), saturated: l?.saturated ?? false, theta: l?.value ?? NaN,
    limits: bounds && [bounds.low, bounds.high], r: l?.r ?? NaN, rate: l?.rate(now) ?? 0,
    reading: recorded() && !complete ? [...counts.values()].reduce((a, b) => a + b, 0) : undefined, number: short,
  });
  const line = byId("verdict");
  if (line.dataset["level"] !== found.level) line.dataset["level"] = found.level;
  say(line, found.text);
  const title = `${connection === "open" ? WORDS[found.level] : "no connection"} – koop${chosen !== "/" && chosen ? ` ${chosen}` : ""}`;
  if (document.title !== title) document.title = title;
  say(byId("connection"), connection === "open" ? "connected" : connection === "lost" ? "connection lost" : "connecting");
  document.body.dataset["connection"] = connection;
  document.body.dataset["mode"] = server?.mode ?? "live";
  say(byId("mode"), connection === "connecting" ? "" : recorded() ? "recorded run" : server?.operate ? "operating" : "read-only");
  say(byId("about"), connection === "open" ? about : "");
  showHealth(rows, now);
  showFleet(new Map([...loops].map(([namespace, other]) => [namespace, other === l ? worst([found.level, other.level(now)]) : other.level(now)])));
  showForce();
  askAgain(now);
  operate.refresh();
}

/** Draw what is due. Not with every frame of the screen: even one in which nothing changes costs the browser work. */
function frame(): void {
  if (!document.hidden) figures.draw(performance.now());
}

byId<HTMLSelectElement>("loop").addEventListener("change", (event) => choose((event.target as HTMLSelectElement).value));
for (const button of document.querySelectorAll<HTMLButtonElement>("#spans button")) {
  button.addEventListener("click", () => view.follow(Number(button.value)));
}
byId("zoomed").addEventListener("click", () => view.follow(view.span));
byId<HTMLInputElement>("log-r").addEventListener("change", (event) => {
  figures.logR = (event.target as HTMLInputElement).checked;
  figures.rebuild();
});
for (const answer of ["yes", "no"]) {
  byId(`confirm-${answer}`).addEventListener("click", () => byId<HTMLDialogElement>("confirm").close(answer));
}

// The address of a server that was restarted, opened in the tab of the old one, loads no page by itself.
addEventListener("hashchange", () => location.reload());

showSpans();
link.connect();
setInterval(slow, SLOW);
setInterval(frame, FRAME);

// For tests and the console: what is kept of a signal, as it came and as it is drawn.
declare global {
  interface Window {
    koop: object;
  }
}
window.koop = {
  raw(name: string) {
    const l = loop();
    const stream = [l?.theta, l?.cost, l?.state].find((s) => s?.signals.has(name));
    return stream ? stream.raw(name) : { t: [], v: [], step: [] };
  },
  columns(name: string, span: number) {
    const l = loop(), found = { t: [] as number[], low: [] as number[], high: [] as number[] };
    const stream = [l?.theta, l?.cost, l?.state].find((s) => s?.signals.has(name));
    stream?.signals.get(name)?.columns.get(span)?.each(-Infinity, Infinity, (t, low, high) => {
      found.t.push(t);
      found.low.push(low);
      found.high.push(high);
    });
    return found;
  },
  counts: () => Object.fromEntries(counts),
  newest: () => newest,
};
