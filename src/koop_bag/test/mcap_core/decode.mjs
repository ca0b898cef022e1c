// Decodes an MCAP file whole with the reference reader, checksums on; one line of JSON a message.
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import zstd from "@foxglove/wasm-zstd";
import { McapIndexedReader, McapStreamReader } from "@mcap/core";
import { readFileSync } from "node:fs";

await zstd.isLoaded;
const decompressHandlers = { zstd: (data, size) => zstd.decompress(data, Number(size)) };
const file = readFileSync(process.argv[2]);

const plain = (key, value) => {
  if (typeof value === "bigint") return value.toString();
  if (ArrayBuffer.isView(value)) return Array.from(value);
  if (typeof value === "number" && !Number.isFinite(value)) return String(value);
  return value;
};

// 1. record by record, in the order of the file
const stream = new McapStreamReader({ decompressHandlers, validateCrcs: true });
stream.append(file);
let streamed = 0;
for (let record; (record = stream.nextRecord()); ) streamed += record.type === "Message";
if (!stream.done()) throw new Error(`${stream.bytesRemaining()} bytes are not records`);

// 2. through summary and indexes
const readable = {
  size: async () => BigInt(file.length),
  read: async (offset, length) => file.subarray(Number(offset), Number(offset + length)),
};
const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
const decoders = new Map();
for (const [id, schema] of reader.schemasById) {
  if (schema.encoding !== "ros2msg") throw new Error(`schema encoding ${schema.encoding}`);
  const definition = new TextDecoder().decode(schema.data);
  decoders.set(id, new MessageReader(parse(definition, { ros2: true })));
}
let indexed = 0;
for await (const message of reader.readMessages({ validateCrcs: true })) {
  const { topic, schemaId } = reader.channelsById.get(message.channelId);
  const { logTime, publishTime, sequence } = message;
  const decoded = decoders.get(schemaId).readMessage(message.data);
  console.log(JSON.stringify({ topic, logTime, publishTime, sequence, decoded }, plain));
  indexed += 1;
}
const counted = Number(reader.statistics.messageCount);
if (streamed !== indexed || streamed !== counted) {
  throw new Error(`${streamed} messages in the file, ${indexed} indexed, ${counted} in the statistics`);
}
console.log(JSON.stringify({ profile: reader.header.profile, messages: counted }));
