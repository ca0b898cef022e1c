// The connection to `koop serve`: the Foxglove WebSocket protocol, reconnected whenever it is lost.

import { parse } from "@foxglove/rosmsg";
import { MessageReader, MessageWriter } from "@foxglove/rosmsg2-serialization";
import type { ParameterValue, ServerInfo } from "@foxglove/ws-protocol";
import { type Channel, FoxgloveClient, type Service } from "@foxglove/ws-protocol";

const SUBPROTOCOLS = ["foxglove.sdk.v1", "foxglove.websocket.v1"];
const FIRST_WAIT = 0.5; // [s] between two attempts
const LONGEST_WAIT = 5; // [s]
const REQUEST = "koop"; // identifies the page's requests for parameters

/** Names of a loop's nodes and topics. */
export interface LoopNames {
  namespace: string;
  plant: string | null;
  lifter: string | null;
  controller: string | null;
  state: string | null;
  cost: string | null;
  theta: string | null;
  guard: string | null;
}

export interface ServerState {
  mode: string;
  operate: boolean;
  loops: LoopNames[];
  session: string;
  about: string; // what the command that runs the loops does now
}

export type Message = Record<string, unknown>;

/** What the link passes on. */
export interface Handlers {
  opened(): void;
  closed(): void;
  takeServer(state: ServerState): void;
  message(topic: string, time: number, message: Message): void;
  takeParameters(values: Map<string, ParameterValue>): void;
  complete(): void;
  note(text: string): void;
  services(): void;
}

interface Call {
  service: Service;
  resolve(answer: Message): void;
  reject(error: Error): void;
}

export class Link {
  private client: FoxgloveClient | undefined;
  private socket: WebSocket | undefined;
  private wait = FIRST_WAIT; // [s] before the next attempt
  private channels = new Map<string, Channel>();
  private services = new Map<string, Service>();
  private readers = new Map<string, MessageReader>();
  private subscriptions = new Map<number, string>(); // topics
  private calls = new Map<number, Call>();
  private topics: string[] = []; // to be subscribed to
  private nextSubscription = 1;
  private nextCall = 1;

  constructor(
    private readonly handlers: Handlers,
    private readonly token: string,
  ) {}

  connect(): void {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const query = this.token ? `?token=${encodeURIComponent(this.token)}` : "";
    const socket = new WebSocket(`${scheme}://${location.host}/${query}`, SUBPROTOCOLS);
    const client = new FoxgloveClient({ ws: socket });
    this.socket = socket;
    this.client = client;
    client.on("open", () => {
      this.wait = FIRST_WAIT;
      this.handlers.opened();
    });
    client.on("error", () => undefined); // a close follows
    client.on("close", () => this.lose());
    client.on("serverInfo", (info) => this.handlers.takeServer(stateOf(info)));
    client.on("status", ({ message }) => {
      if (message === "recording complete") this.handlers.complete();
      else this.handlers.note(message);
    });
    client.on("advertise", (channels) => {
      for (const channel of channels) this.channels.set(channel.topic, channel);
      this.subscribe();
    });
    client.on("advertiseServices", (services) => {
      for (const service of services) this.services.set(service.name, service);
      this.handlers.services();
    });
    client.on("message", ({ subscriptionId, timestamp, data }) => {
      const topic = this.subscriptions.get(subscriptionId) ?? "";
      const channel = this.channels.get(topic);
      if (!channel) return;
      try {
        const message = this.reader(channel.schema).readMessage<Message>(data);
        this.handlers.message(topic, Number(timestamp) / 1e9, message);
      } catch (error) {
        this.handlers.note(`${topic} cannot be decoded: ${(error as Error).message}`);
      }
    });
    client.on("parameterValues", ({ parameters }) =>
      this.handlers.takeParameters(new Map(parameters.map((p) => [p.name, p.value]))),
    );
    client.on("serviceCallResponse", ({ callId, data }) => {
      const call = this.end(callId);
      if (!call) return;
      try {
        const schema = call.service.response?.schema ?? "";
        call.resolve(this.reader(schema).readMessage<Message>(data));
      } catch (error) {
        call.reject(new Error(`the answer cannot be decoded: ${(error as Error).message}`));
      }
    });
    client.on("serviceCallFailure", ({ callId, message }) => {
      this.end(callId)?.reject(new Error(message));
    });
  }

  /** Subscribe to these topics only, in one request: a recording then keeps their order. */
  follow(topics: string[]): void {
    this.topics = topics;
    this.subscribe();
  }

  /** Get these parameters now and whenever they change. */
  watch(names: string[]): void {
    if (!this.isOpen || !names.length) return;
    this.client?.subscribeParameterUpdates(names);
    this.client?.getParameters(names, REQUEST);
  }

  offers(service: string): boolean {
    return this.services.has(service);
  }

  async call(name: string, request: Message): Promise<Message> {
    const { client } = this;
    const service = this.services.get(name);
    if (!service || !client) throw new Error(`${name} is not available: its node may have ended`);
    const schema = service.request?.schema ?? "";
    const bytes = new MessageWriter(parse(schema, { ros2: true })).writeMessage(request);
    const callId = this.nextCall++;
    return await new Promise((resolve, reject) => {
      this.calls.set(callId, { resolve, reject, service });
      const data = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
      client.sendServiceCallRequest({ serviceId: service.id, callId, encoding: "cdr", data });
    });
  }

  private get isOpen(): boolean {
    return this.socket?.readyState === WebSocket.OPEN;
  }

  private end(callId: number): Call | undefined {
    const call = this.calls.get(callId);
    this.calls.delete(callId);
    return call;
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
    if (!this.isOpen) return;
    const all = [...this.subscriptions];
    const subscriptionIds = all.filter(([, t]) => !this.topics.includes(t)).map(([id]) => id);
    for (const id of subscriptionIds) this.subscriptions.delete(id);
    if (subscriptionIds.length) this.send({ op: "unsubscribe", subscriptionIds });
    const subscribed = new Set(this.subscriptions.values());
    const channels = this.topics
      .filter((topic) => !subscribed.has(topic))
      .flatMap((topic) => this.channels.get(topic) ?? []);
    const subscriptions = channels.map((channel) => {
      const id = this.nextSubscription++;
      this.subscriptions.set(id, channel.topic);
      return { id, channelId: channel.id };
    });
    if (subscriptions.length) this.send({ op: "subscribe", subscriptions });
  }

  private send(message: object): void {
    this.socket?.send(JSON.stringify(message));
  }

  private lose(): void {
    for (const map of [this.channels, this.subscriptions, this.services]) map.clear();
    for (const call of this.calls.values()) call.reject(new Error("the connection was lost"));
    this.calls.clear();
    this.handlers.services();
    this.handlers.closed();
    this.wait = Math.min(LONGEST_WAIT, this.wait * 1.6);
    setTimeout(() => this.connect(), this.wait * 1000);
  }
}

function stateOf({ metadata, sessionId }: ServerInfo): ServerState {
  return {
    mode: metadata?.["koop_mode"] ?? "live",
    operate: metadata?.["koop_operate"] === "true",
    loops: JSON.parse(metadata?.["koop_loops"] ?? "[]") as LoopNames[],
    session: sessionId ?? "",
    about: metadata?.["koop_about"] ?? "",
  };
}
