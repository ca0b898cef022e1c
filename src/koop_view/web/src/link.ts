// The connection to `koop serve`: the Foxglove WebSocket protocol, with a new try whenever it is lost.

import { parse } from "@foxglove/rosmsg";
import { MessageReader, MessageWriter } from "@foxglove/rosmsg2-serialization";
import { FoxgloveClient, type Channel, type ParameterValue, type Service } from "@foxglove/ws-protocol";

const SUBPROTOCOLS = ["foxglove.sdk.v1", "foxglove.websocket.v1"];
const FIRST_WAIT = 0.5, LONGEST_WAIT = 5; // [s] between two tries
const ANSWER_WITHIN = 8; // [s]
const UNAUTHORIZED = 401;

export interface LoopNames {
  namespace: string;
  plant: string | null;
  lifter: string | null;
  controller: string | null;
  state: string | null;
  cost: string | null;
  theta: string | null;
}

export interface ServerState {
  mode: string;
  operate: boolean;
  version: string;
  loops: LoopNames[];
  session: string;
  about: string; // what whoever started the loops does now
}

export interface Handlers {
  opened(): void;
  closed(): void;
  server(state: ServerState): void;
  message(topic: string, time: number, message: Record<string, unknown>, bytes: number): void;
  parameters(values: Map<string, ParameterValue>): void;
  complete(): void;
  note(text: string): void;
  tokenRefused(): void;
  services(): void;
}

export class Link {
  private client: FoxgloveClient | undefined;
  private socket: WebSocket | undefined;
  private channels = new Map<string, Channel>();
  private topics = new Map<number, string>(); // of subscriptions
  private readers = new Map<string, MessageReader>();
  private subscriptions = new Map<string, number>();
  private wanted: string[] = [];
  private available = new Map<string, Service>();
  private calls = new Map<number, { resolve: (data: Record<string, unknown>) => void; reject: (error: Error) => void; service: Service }>();
  private nextSubscription = 1;
  private nextCall = 1;
  private wait = FIRST_WAIT;
  private opened = false;
  private asked: string[] = [];
  private told = new Set<string>();

  constructor(private readonly handlers: Handlers, private token: string) {}

  connect(): void {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const query = this.token ? `?token=${encodeURIComponent(this.token)}` : "";
    const socket = new WebSocket(`${scheme}://${location.host}/${query}`, SUBPROTOCOLS);
    const client = new FoxgloveClient({ ws: socket });
    this.socket = socket;
    this.client = client;
    this.opened = false;
    client.on("open", () => {
      this.opened = true;
      this.wait = FIRST_WAIT;
      this.handlers.opened();
    });
    client.on("error", () => undefined); // a close follows
    client.on("close", () => { if (this.client === client) this.lost(); });
    client.on("serverInfo", (info) => this.handlers.server({
      mode: info.metadata?.["koop_mode"] ?? "live",
      operate: info.metadata?.["koop_operate"] === "true",
      version: info.metadata?.["koop_version"] ?? "",
      loops: loopsOf(info.metadata?.["koop_loops"]),
      session: info.sessionId ?? "",
      about: info.metadata?.["koop_about"] ?? "",
    }));
    client.on("status", (status) => {
      if (status.message === "recording complete") this.handlers.complete();
      else this.handlers.note(status.message);
    });
    client.on("advertise", (channels) => {
      for (const channel of channels) this.channels.set(channel.topic, channel);
      this.subscribe();
    });
    client.on("unadvertise", (ids) => {
      for (const [topic, channel] of this.channels) {
        if (!ids.includes(channel.id)) continue;
        this.channels.delete(topic);
        const subscription = this.subscriptions.get(topic);
        this.subscriptions.delete(topic);
        if (subscription !== undefined) this.topics.delete(subscription);
      }
    });
    client.on("advertiseServices", (services) => {
      for (const service of services) this.available.set(service.name, service);
      this.handlers.services();
    });
    client.on("unadvertiseServices", (ids) => {
      for (const [name, service] of this.available) if (ids.includes(service.id)) this.available.delete(name);
      this.handlers.services();
    });
    client.on("message", ({ subscriptionId, timestamp, data }) => {
      const topic = this.topics.get(subscriptionId);
      if (topic === undefined) return;
      const channel = this.channels.get(topic);
      if (!channel) return;
      try {
        const message = this.reader(channel.schema).readMessage<Record<string, unknown>>(data);
        this.handlers.message(topic, Number(timestamp) / 1e9, message, data.byteLength);
      } catch (error) {
        this.once(`${topic} cannot be decoded: ${(error as Error).message}`);
      }
    });
    client.on("parameterValues", ({ parameters }) =>
      this.handlers.parameters(new Map(parameters.map((p) => [p.name, p.value]))));
    client.on("serviceCallResponse", ({ callId, data }) => {
      const call = this.calls.get(callId);
      if (!call) return;
      this.calls.delete(callId);
      try {
        const schema = call.service.response?.schema ?? call.service.responseSchema ?? "";
        call.resolve(this.reader(schema).readMessage<Record<string, unknown>>(data));
      } catch (error) {
        call.reject(new Error(`its answer cannot be decoded: ${(error as Error).message}`));
      }
    });
    client.on("serviceCallFailure", ({ callId, message }) => {
      this.calls.get(callId)?.reject(new Error(message));
      this.calls.delete(callId);
    });
  }

  /** Ask for the messages of these topics only, all in one request: a recording then keeps their order. */
  want(topics: string[]): void {
    this.wanted = topics;
    this.subscribe();
  }

  /** Ask for these parameters now and whenever they change. */
  watch(names: string[]): void {
    if (!this.client || !this.opened) return;
    if (this.asked.length) this.client.unsubscribeParameterUpdates(this.asked);
    this.asked = names;
    if (!names.length) return;
    this.client.getParameters(names, "koop");
    this.client.subscribeParameterUpdates(names);
  }

  /** Ask again for what is watched. */
  refresh(): void {
    if (this.client && this.opened && this.asked.length) this.client.getParameters(this.asked, "koop");
  }

  offers(service: string): boolean {
    return this.available.has(service);
  }

  async call(name: string, request: Record<string, unknown>): Promise<Record<string, unknown>> {
    const service = this.available.get(name);
    if (!service || !this.client) throw new Error(`${name} is not there: has its node ended?`);
    const schema = service.request?.schema ?? service.requestSchema ?? "";
    const data = new MessageWriter(parse(schema, { ros2: true })).writeMessage(request);
    const callId = this.nextCall++;
    const client = this.client;
    return await new Promise((resolve, reject) => {
      this.calls.set(callId, { resolve, reject, service });
      setTimeout(() => {
        if (this.calls.delete(callId)) reject(new Error(`no answer within ${ANSWER_WITHIN} s`));
      }, ANSWER_WITHIN * 1000);
      client.sendServiceCallRequest({ serviceId: service.id, callId, encoding: "cdr", data: new DataView(data.buffer, data.byteOffset, data.byteLength) });
    });
  }

  private reader(schema: string): MessageReader {
    let reader = this.readers.get(schema);
    if (!reader) {
      reader = new MessageReader(parse(schema, { ros2: true }));
      this.readers.set(schema, reader);
    }
    return reader;
  }

  private subscribe(): void {
    if (!this.socket || !this.opened) return;
    const gone = [...this.subscriptions].filter(([topic]) => !this.wanted.includes(topic));
    if (gone.length) {
      this.send({ op: "unsubscribe", subscriptionIds: gone.map(([, id]) => id) });
      for (const [topic, id] of gone) {
        this.subscriptions.delete(topic);
        this.topics.delete(id);
      }
    }
    const fresh = this.wanted.filter((topic) => this.channels.has(topic) && !this.subscriptions.has(topic));
    if (!fresh.length) return;
    const subscriptions = fresh.map((topic) => {
      const id = this.nextSubscription++;
      this.subscriptions.set(topic, id);
      this.topics.set(id, topic);
      return { id, channelId: this.channels.get(topic)!.id };
    });
    this.send({ op: "subscribe", subscriptions });
  }

  private send(message: object): void {
    this.socket?.send(JSON.stringify(message));
  }

  private once(text: string): void {
    if (this.told.has(text)) return;
    this.told.add(text);
    this.handlers.note(text);
  }

  private lost(): void {
    const refused = !this.opened && this.token !== "";
    this.client = undefined;
    this.opened = false;
    this.channels.clear();
    this.topics.clear();
    this.subscriptions.clear();
    this.available.clear();
    this.asked = [];
    for (const call of this.calls.values()) call.reject(new Error("the connection was lost"));
    this.calls.clear();
    this.handlers.services();
    this.handlers.closed();
    // A browser does not say why a WebSocket was refused; to a request the server says it.
    const again = (): void => { setTimeout(() => this.connect(), this.wait * 1000); };
    this.wait = Math.min(LONGEST_WAIT, this.wait * 1.6);
    if (!refused) {
      again();
      return;
    }
    fetch(`/?token=${encodeURIComponent(this.token)}`, { cache: "no-store" }).then((answer) => {
      if (answer.status === UNAUTHORIZED) {
        this.token = "";
        this.handlers.tokenRefused();
      }
      again();
    }, again);
  }
}

function loopsOf(text: string | undefined): LoopNames[] {
  try {
    const found: unknown = JSON.parse(text ?? "[]");
    return Array.isArray(found) ? (found as LoopNames[]) : [];
  } catch {
    return [];
  }
}
