// The operator's page: what comes over the link goes into loops, the chosen loop onto the page.

import type { ParameterValue } from "@foxglove/ws-protocol";
import { byId, make, setText } from "./dom";
import { Figures } from "./figures";
import { clock } from "./format";
import { type Level, verdict, worst } from "./health";
import { Link, type Message, type ServerState } from "./link";
import { Loop, type Status } from "./loop";
import { Operator } from "./operator";
import { PARAMETERS, showForce, showHealth, showLoops, showSpans, WORDS } from "./panels";
import { TimeAxis } from "./time_axis";

const MOST_NOTES = 40;
const FRAME = 75; // [ms] between two looks at which figures are due: a frame costs even if none is
const REFRESH = 250; // [ms] between two looks at health and words
const DISCOVERY = 4; // [s] that a server which has just started may need to find the loops
const CONNECTING = 2; // [s] without a connection at the start, after which it counts as lost
const TOKEN = "koop token"; // in the storage of the tab
const WARNING = 30; // rcl_interfaces/msg/Log
const NOT_ITS_TOKEN =
  "Read-only: the token is not this server's; it may have been restarted. " +
  "Open the address that it has printed.";

/** Seconds on the page's own clock. */
function now(): number {
  return performance.now() / 1000;
}

export class Page {
  connection: "open" | "lost" | "connecting" = "connecting";
  server: ServerState | undefined;
  readonly loops = new Map<string, Loop>();
  chosen = decodeURIComponent(/[#&]loop=([^&]*)/.exec(location.hash)?.[1] ?? "");
  newest = NaN; // receive time of the newest message [s]
  private newestAt = NaN; // when it came
  private begin = 0; // of a recording [s]; its figures count from there
  private lostAt = now();
  private openedAt = NaN;
  private watched = ""; // names of parameters
  private read: number | undefined; // messages so far of a recording that is not complete
  private readonly parameters = new Map<string, ParameterValue>();
  private readonly time = new TimeAxis(
    () => this.firstTime(),
    () => this.currentTime(),
  );
  private readonly figures = new Figures(this, this.time);
  private readonly token: string;
  private readonly link: Link;
  private readonly operator: Operator;

  constructor() {
    this.time.changed = () => {
      this.figures.redraw();
      showSpans(this.time);
    };
    this.token = this.takeToken();
    this.link = new Link(this, this.token);
    this.operator = new Operator(this, this.link);
    byId("loop").addEventListener("change", () =>
      this.choose(byId<HTMLSelectElement>("loop").value),
    );
    for (const button of document.querySelectorAll<HTMLButtonElement>("#spans button")) {
      button.addEventListener("click", () => this.time.follow(Number(button.value)));
    }
    byId("zoomed").addEventListener("click", () => this.time.follow(this.time.span));
    // the address of a restarted server, opened in the tab of the old one, loads no page by itself
    addEventListener("hashchange", () => location.reload());
    showSpans(this.time);
    this.link.connect();
    setInterval(() => this.refresh(), REFRESH);
    setInterval(() => {
      if (!document.hidden) this.figures.draw(performance.now());
    }, FRAME);
  }

  // -- what is shown --------------------------------------------------------------------------

  get loop(): Loop | undefined {
    return this.loops.get(this.chosen);
  }

  get recorded(): boolean {
    return this.server?.mode === "recorded";
  }

  get operate(): boolean {
    return this.server?.operate ?? false;
  }

  /** theta's limits, of each knob; empty: not known. */
  get limits(): [number, number][] {
    const low = this.each("theta_min");
    const high = this.each("theta_max");
    return low.map((value, i): [number, number] => [value, high[i] ?? NaN]);
  }

  /** A parameter of the controller for each knob: one number is that of all. */
  each(name: string): number[] {
    const value = this.parameter(`controller.${name}`);
    const knobs = this.loop?.knobs ?? [];
    if (typeof value === "number") return knobs.map(() => value);
    return Array.isArray(value) ? value.map(Number) : [];
  }

  /** A parameter of the chosen loop, such as `controller.theta_min`. */
  parameter(name: string): ParameterValue {
    const [role, key] = name.split(".") as ["controller" | "lifter", string];
    return this.parameters.get(`${this.loop?.names[role]}.${key}`);
  }

  private firstTime(): number {
    const times = (this.loop?.all ?? []).map((stream) => stream.first);
    return Math.min(...times.filter(Number.isFinite));
  }

  /** The server's time; of a recording its end, for what comes later are only reports. */
  private currentTime(): number {
    if (this.recorded) {
      const times = (this.loop?.all ?? []).map((stream) => stream.last);
      return Math.max(...times.filter(Number.isFinite));
    }
    return this.newest + (this.connection === "open" ? Math.max(0, now() - this.newestAt) : 0);
  }

  // -- the link -------------------------------------------------------------------------------

  /** The token of the address, kept for a reload and removed from what others may see. */
  private takeToken(): string {
    const token = /[#&]token=([^&]*)/.exec(location.hash)?.[1];
    if (token) {
      sessionStorage.setItem(TOKEN, decodeURIComponent(token));
      const hash = this.chosen ? `#loop=${encodeURIComponent(this.chosen)}` : "";
      history.replaceState(null, "", location.pathname + location.search + hash);
    }
    return sessionStorage.getItem(TOKEN) ?? "";
  }

  opened(): void {
    this.connection = "open";
    this.openedAt = now();
    this.watched = "";
  }

  closed(): void {
    if (this.connection === "open") this.lostAt = now();
    const isNew = this.connection === "connecting" && now() - this.lostAt < CONNECTING;
    this.connection = isNew ? "connecting" : "lost";
  }

  services(): void {
    this.operator.refresh();
  }

  complete(): void {
    this.read = undefined;
    this.figures.redraw();
  }

  takeParameters(values: Map<string, ParameterValue>): void {
    for (const [name, value] of values) this.parameters.set(name, value);
    this.figures.redraw();
  }

  takeServer(server: ServerState): void {
    const isRecorded = server.mode === "recorded";
    const isOther = server.mode !== this.server?.mode || server.session !== this.server.session;
    if (this.server && isOther && (isRecorded || this.recorded)) location.reload();
    if (isOther && this.token && !server.operate) this.note(NOT_ITS_TOKEN, "error");
    this.server = server;
    if (isRecorded && !this.watched) this.restart(); // it is sent whole after every connection
    if (isRecorded && !this.time.recorded) {
      this.time.recorded = true;
      this.time.follow(0);
    }
    for (const names of server.loops) {
      const loop = this.loops.get(names.namespace);
      if (loop) loop.rename(names);
      else this.loops.set(names.namespace, new Loop(names));
    }
    if (!this.loops.has(this.chosen)) this.chosen = [...this.loops.keys()][0] ?? this.chosen;
    this.follow();
    this.refresh();
  }

  /** Subscribe to the chosen loop. */
  private follow(): void {
    const topics = this.loop?.topics ?? [];
    this.link.follow([...topics, "/diagnostics", "/rosout"]);
    const names = Object.entries(PARAMETERS).flatMap(([role, units]) => {
      const node = this.loop?.names[role as keyof typeof PARAMETERS];
      return node ? Object.keys(units).map((key) => `${node}.${key}`) : [];
    });
    if (names.join() === this.watched) return;
    this.watched = names.join();
    this.link.watch(names);
  }

  choose(namespace: string): void {
    this.chosen = namespace;
    history.replaceState(null, "", `#loop=${encodeURIComponent(namespace)}`);
    if (this.recorded) this.restart();
    this.follow();
    this.figures.redraw();
    this.refresh();
  }

  /** A recording is sent again: what was read before would be there twice. */
  private restart(): void {
    for (const loop of this.loops.values()) loop.clear();
    this.read = this.begin = 0;
  }

  message(topic: string, time: number, message: Message): void {
    if (this.read !== undefined) this.read += 1;
    this.newest = time;
    this.newestAt = now();
    if (topic === "/diagnostics") this.takeDiagnostics(message);
    else if (topic === "/rosout") this.takeLog(message, time);
    else {
      if (this.recorded) this.begin ||= time;
      this.loop?.take(topic, time - this.begin, now(), message);
    }
  }

  private takeDiagnostics(message: Message): void {
    type Pair = { key: string; value: string };
    type Raw = Omit<Status, "values"> & { hardware_id: string; values: Pair[] };
    for (const raw of message["status"] as Raw[]) {
      const values = Object.fromEntries(raw.values.map(({ key, value }) => [key, value]));
      const status = { ...raw, hardware: raw.hardware_id, values };
      this.ownerOf(status)?.report(status, now());
    }
  }

  /** The loop that a report is about: by its namespace, the longest that fits. */
  private ownerOf({ name, hardware }: Status): Loop | undefined {
    const fits = [...this.loops.values()].filter(({ names }) => {
      const isOwn = [names.plant, names.lifter, names.controller].includes(name);
      return isOwn || hardware === `koop${names.namespace}`.replace(/\/$/, "");
    });
    return fits.sort((a, b) => b.names.namespace.length - a.names.namespace.length)[0];
  }

  private takeLog(message: Message, time: number): void {
    const level = message["level"] as number;
    if (level < WARNING) return;
    this.note(`${message["name"]}: ${message["msg"]}`, level > WARNING ? "error" : "warn", time);
  }

  note(text: string, level: "warn" | "error" = "warn", time = Date.now() / 1000): void {
    const notes = byId("notes");
    const top = notes.firstElementChild as HTMLElement | null;
    if (top?.dataset["text"] === text) {
      const times = Number(top.dataset["times"] ?? 1) + 1;
      top.dataset["times"] = String(times);
      setText(top.firstElementChild!, `${clock(time)} ×${times} `);
      return;
    }
    const when = make("small", { text: `${clock(time)} ` });
    notes.prepend(make("li", { data: { level, text } }, when, make("span", { text })));
    while (notes.children.length > MOST_NOTES) notes.lastElementChild?.remove();
  }

  // -- the words of the page ------------------------------------------------------------------

  private refresh(): void {
    const { loop, server, connection, chosen } = this;
    const isOpen = connection === "open";
    const time = now();
    if (isOpen && time - this.openedAt > DISCOVERY) {
      const running = new Set(server?.loops.map((names) => names.namespace));
      for (const [namespace, other] of this.loops) if (!running.has(namespace)) other.end();
    }
    const about = isOpen ? (server?.about ?? "") : "";
    const mode = this.recorded ? "recorded" : isOpen ? "live" : "unknown";
    const rows = loop?.rows(time, mode) ?? [];
    const { level, text } = verdict({
      connection,
      lostFor: time - this.lostAt,
      recorded: this.recorded,
      read: this.read,
      about,
      rows,
      limits: this.limits,
      loop: loop?.now,
      rate: loop?.rate(time) ?? 0,
    });
    byId("verdict").dataset["level"] = level;
    setText(byId("verdict"), text);
    const name = chosen && chosen !== "/" ? ` ${chosen}` : "";
    document.title = `${isOpen ? WORDS[level] : "no connection"} – koop${name}`;
    document.body.dataset["connection"] = connection;
    document.body.dataset["mode"] = server?.mode ?? "live";
    const connected = connection === "lost" ? "connection lost" : connection;
    setText(byId("connection"), isOpen ? "connected" : connected);
    const right = this.operate ? "operating" : "read-only";
    setText(byId("mode"), !server ? "" : this.recorded ? "recorded run" : right);
    setText(byId("about"), about);
    const levels = new Map(
      [...this.loops].map(([n, other]) => [n, this.levelOf(other, level, time)]),
    );
    showLoops(this.loops, levels, chosen);
    showHealth(rows, this.recorded, time);
    showForce(this);
    this.figures.showPairs();
    this.operator.refresh();
  }

  private levelOf(loop: Loop, verdictLevel: Level, time: number): Level {
    if (this.recorded || this.connection !== "open") return "off";
    return loop === this.loop ? worst([verdictLevel, loop.level(time)]) : loop.level(time);
  }
}
