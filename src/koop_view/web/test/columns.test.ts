import assert from "node:assert/strict";
import { test } from "node:test";
import { Columns } from "../src/columns";
import { curves, SPANS, Stream } from "../src/stream";

type Row = { t: number; low: number; high: number; rising: boolean };

function rows(columns: Columns, from = -Infinity, to = Infinity): Row[] {
  const found: Row[] = [];
  columns.each(from, to, (t, low, high, rising) => found.push({ t, low, high, rising }));
  return found;
}

// Numbers without a pattern, the same every time.
function* noise(seed = 1): Generator<number> {
  for (let x = seed; ; ) {
    x = (x * 1103515245 + 12345) % 2147483648;
    yield x / 2147483648 - 0.5;
  }
}

test("every sample lies within the column of its time, and the column's edges are samples", () => {
  const columns = new Columns(60, 600),
    random = noise(),
    samples: [number, number][] = [];
  for (let i = 0; i < 12000; i += 1) {
    const sample: [number, number] = [1.7e9 + i * 0.005, random.next().value!];
    samples.push(sample);
    columns.push(...sample);
  }
  const found = rows(columns);
  assert.ok(found.length >= 599 && found.length <= 600);
  for (const { t, low, high } of found) {
    const own = samples
      .filter(([s]) => Math.floor(s / columns.width) === Math.round(t / columns.width))
      .map(([, v]) => v);
    assert.equal(low, Math.min(...own));
    assert.equal(high, Math.max(...own));
  }
});

test("a column says which of its edges came first", () => {
  const columns = new Columns(10, 10);
  for (const [t, v] of [
    [0.1, 1],
    [0.2, 5],
    [0.9, 3],
    [1.1, 5],
    [1.2, 1],
    [1.9, 3],
  ] as const)
    columns.push(t, v);
  assert.deepEqual(
    rows(columns).map((row) => row.rising),
    [true, false],
  );
});

test("the oldest columns give way, and silence leaves them empty", () => {
  const columns = new Columns(10, 10);
  for (let t = 0.5; t < 15; t += 1) columns.push(t, t);
  assert.deepEqual(
    rows(columns).map((row) => row.t),
    [5, 6, 7, 8, 9, 10, 11, 12, 13, 14],
  );
  columns.push(18.5, 1);
  assert.deepEqual(
    rows(columns).map((row) => row.t),
    [9, 10, 11, 12, 13, 14, 18],
  );
  columns.push(1000, 1);
  assert.deepEqual(
    rows(columns).map((row) => row.t),
    [1000],
  );
  columns.push(3, 1); // long past
  assert.deepEqual(
    rows(columns).map((row) => row.t),
    [1000],
  );
});

test("columns over all time cover it at half their number or better, and lose no extreme", () => {
  const columns = new Columns(0, 64),
    random = noise(7);
  let least = Infinity,
    most = -Infinity;
  for (let i = 0; i < 100000; i += 1) {
    const v = random.next().value!,
      t = 1.7e9 + i * 0.013;
    [least, most] = [Math.min(least, v), Math.max(most, v)];
    columns.push(t, v);
    if (i % 9973 === 5000) {
      const found = rows(columns);
      assert.ok(found.length > 30 && found.length <= 64, `${found.length} columns`);
      assert.equal(Math.min(...found.map((row) => row.low)), least);
      assert.equal(Math.max(...found.map((row) => row.high)), most);
      assert.ok(found[0]!.t <= 1.7e9 && found.at(-1)!.t + columns.width >= t);
    }
  }
});

test("what is not a number is left out", () => {
  const columns = new Columns(10, 10);
  columns.push(0.5, NaN);
  columns.push(1.5, 2);
  columns.push(2.5, Infinity);
  assert.deepEqual(
    rows(columns).map((row) => [row.t, row.low]),
    [[1, 2]],
  );
});

test("the last seconds are drawn as they came, a minute as columns of the same samples", () => {
  const stream = new Stream(),
    t0 = 1.7e9;
  for (let i = 0; i < 13000; i += 1) stream.push(t0 + i * 0.005, i, ["a"], [Math.sin(i / 40)]);
  const end = stream.last;
  const [t, v] = curves(stream, ["a"], end - 10, end, 60);
  const drawn = t.filter((time) => time >= end - 10);
  assert.equal(drawn.length, 2001);
  assert.equal(v!.at(-1), Math.sin(12999 / 40));
  const [columns, values] = curves(stream, ["a"], end - 60, end, 60);
  assert.ok(columns.length <= 1202 && columns.length > 1150, `${columns.length}`);
  assert.ok(columns.every((time, i) => i === 0 || time > columns[i - 1]!));
  assert.ok(Math.abs(Math.max(...(values as number[])) - 1) < 1e-3);
});

test("a silence breaks the line", () => {
  const stream = new Stream();
  for (const from of [100, 110])
    for (let i = 0; i < 400; i += 1) stream.push(from + i * 0.005, i, ["a"], [1]);
  for (const to of [112, 150]) {
    const [, v] = curves(stream, ["a"], 95, to, 60);
    assert.equal(v!.filter((value) => value === null).length, 1);
  }
});

test("hours at 200 Hz need no more memory than the first minutes", () => {
  const stream = new Stream(),
    names = ["x[0]", "x[1]", "x[2]", "x[3]"];
  const size = (): number =>
    [...stream.signals.values()].reduce(
      (sum, s) => sum + s.raw.length + [...s.columns.values()].reduce((a, c) => a + c.count, 0),
      0,
    );
  let i = 0;
  const run = (seconds: number): void => {
    for (const end = i + seconds * 200; i < end; i += 1)
      stream.push(1.7e9 + i / 200, i, names, [i, -i, i % 7, 1]);
  };
  run(90);
  const before = size();
  run(4 * 3600);
  assert.equal(size(), before);
  assert.equal(stream.kept, 16384);
  for (const span of SPANS) {
    const found = rows(stream.signals.get("x[0]")!.columns.get(span)!);
    assert.equal(found.at(-1)!.high, i - 1);
    assert.ok(found.length > 550);
  }
  assert.equal(rows(stream.signals.get("x[0]")!.columns.get(0)!)[0]!.low, 0);
});
