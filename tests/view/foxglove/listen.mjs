// node listen.mjs URL COUNTS: print the messages of all channels, decoded, until each of some topics has come so many times.
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import protocol from "@foxglove/ws-protocol";
import WebSocket from "ws";

const { FoxgloveClient } = protocol;
const [url, counts] = process.argv.slice(2);
const wanted = new Map(Object.entries(JSON.parse(counts)));
const client = new FoxgloveClient({ ws: new WebSocket(url, [FoxgloveClient.SUPPORTED_SUBPROTOCOL]) });
const readers = new Map();

const plain = (key, value) => {
  if (typeof value === "bigint") return Number(value);
  if (ArrayBuffer.isView(value)) return Array.from(value);
  if (typeof value === "number" && !Number.isFinite(value)) return String(value);
  return value;
};

client.on("error", (error) => { console.error(String(error)); process.exitCode = 1; });
client.on("advertise", (channels) => {
  for (const channel of channels) {
    const definitions = parse(channel.schema, { ros2: true });
    readers.set(client.subscribe(channel.id), [channel.topic, new MessageReader(definitions)]);
  }
});
client.on("message", ({ subscriptionId, timestamp, data }) => {
  const [topic, reader] = readers.get(subscriptionId);
  const message = reader.readMessage(data);
  console.log(JSON.stringify({ topic, time: String(timestamp), message }, plain));
  if (wanted.has(topic)) wanted.set(topic, wanted.get(topic) - 1);
  if ([...wanted.values()].every((left) => left <= 0)) client.close();
});
