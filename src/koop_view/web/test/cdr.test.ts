// What the page decodes is what another reader finds in the bag. KOOP_MESSAGES is a file of
// {schema, hex, values} in JSON lines, written from a bag by the other reader.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import { Loop } from "../src/loop";

const file = process.env["KOOP_MESSAGES"];

function plain(value: unknown): unknown {
  if (typeof value === "bigint") return Number(value);
  if (typeof value === "number") return Number.isFinite(value) ? value : String(value);
  if (ArrayBuffer.isView(value)) return [...(value as unknown as Iterable<number>)].map(plain);
  if (Array.isArray(value)) return value.map(plain);
  if (value && typeof value === "object")
    return Object.fromEntries(Object.entries(value).map(([k, v]) => [k, plain(v)]));
  return value;
}

test("the messages of a bag decode to what another reader finds in them", { skip: !file }, () => {
  const readers = new Map<string, MessageReader>(),
    loop = new Loop({
      namespace: "/",
      plant: null,
      lifter: null,
      controller: null,
      state: "/state",
      cost: "/cost",
      theta: "/theta",
    });
  const seen = {
    "/state": [] as number[][],
    "/cost": [] as number[][],
    "/theta": [] as number[][],
  };
  let schemas: Record<string, string> = {},
    n = 0;
  for (const line of readFileSync(file!, "utf8").trim().split("\n")) {
    const item = JSON.parse(line);
    if (item.schemas) {
      schemas = item.schemas;
      for (const [name, schema] of Object.entries(schemas))
        readers.set(name, new MessageReader(parse(schema, { ros2: true })));
      continue;
    }
    const message = readers
      .get(item.type)!
      .readMessage<Record<string, unknown>>(new Uint8Array(Buffer.from(item.hex, "hex")));
    assert.deepEqual(plain(message), item.values);
    n += 1;
    const kept = seen[item.topic as keyof typeof seen];
    if (!kept) continue;
    loop.take(item.topic, n * 0.001, 0, message);
    const v = item.values;
    kept.push(item.topic === "/state" ? v.x : item.topic === "/cost" ? [v.r] : v.theta);
  }
  assert.ok(n > 100);
  // and what is kept for the figures are these values, in their order
  assert.deepEqual(
    loop.state.raw("x[1]").v,
    seen["/state"].map((x) => x[1]),
  );
  assert.deepEqual(
    loop.cost.raw("r").v.map(plain),
    seen["/cost"].map((x) => x[0]),
  );
  assert.deepEqual(
    loop.theta.raw("theta").v,
    seen["/theta"].map((x) => x[0]),
  );
});
