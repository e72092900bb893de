import { readFileSync } from "node:fs";
import { decode } from "@msgpack/msgpack";
import { describe, expect, it } from "vitest";
import { floats, numbers, pack, read, type WireArray } from "../src/protocol";
import { settings } from "../src/schema";

interface Vector {
  topic: string;
  case: string;
  fields: Record<string, unknown>;
  hex: string;
}

const golden = new URL("../../../../proto/golden/vectors.json", import.meta.url);
const vectors = JSON.parse(readFileSync(golden, "utf8")) as Vector[];
const bytes = (hex: string): Uint8Array => Uint8Array.from(Buffer.from(hex, "hex"));

describe("the wire", () => {
  it.each(vectors.filter((v) => v.topic === "afm/scanline" && v.case !== "nil"))("reads the heights of $case", (vector) => {
    const fields = decode(bytes(vector.hex)) as { height_m: WireArray };
    const expected = vector.fields["height_m"] as { shape: number[] };
    const found = Array.from(numbers(fields.height_m));
    expect(found.length).toBe(expected.shape.reduce((a, b) => a * b, 1));
    expect(found.every((value) => Number.isFinite(value))).toBe(true);
  });

  it.each(["haptic/state", "afm/state", "law/status"])("reads the golden bytes of %s", (topic) => {
    const vector = vectors.find((v) => v.topic === topic && v.case === "ordinary")!;
    const fields = decode(bytes(vector.hex)) as Record<string, unknown>;
    expect(Object.keys(fields).sort()).toEqual(Object.keys(vector.fields).sort());
  });

  it.each([
    ["u1", new Uint8Array([1, 255])],
    ["i2", new Int16Array([-2, 300])],
    ["i4", new Int32Array([-70000, 1])],
    ["f4", new Float32Array([1.5, -2])],
    ["f8", new Float64Array([1e-9, -1])],
  ] as const)("reads arrays of %s wherever they lie in a frame", (dtype, values) => {
    const data = new Uint8Array(values.buffer);
    const shifted = new Uint8Array(data.length + 1);
    shifted.set(data, 1);
    expect(Array.from(numbers({ dtype, shape: [2], data: shifted.subarray(1) }))).toEqual(Array.from(values));
  });
});

it("reads a frame of samples and packs a request", () => {
  const samples = Float32Array.from([0, 1e-3, 5, 6]);
  const frame = pack({ k: "tick", streams: { hand: { n: 2, t0: 1, data: new Uint8Array(samples.buffer) } } });
  const tick = read(frame.buffer.slice(frame.byteOffset, frame.byteOffset + frame.byteLength));
  if (tick.k !== "tick") throw new Error(tick.k);
  expect(Array.from(floats(tick.streams!["hand"]!.data))).toEqual(Array.from(samples));
});

describe("forms", () => {
  const schema = {
    properties: { wave: { $ref: "#/$defs/Wave" }, law: { enum: ["wave"], type: "string", default: "wave" } },
    $defs: {
      Wave: {
        properties: {
          impedance_n_s_per_m: { type: "number", minimum: 0.1, maximum: 5, default: 2, description: "of the line" },
          filter_s: { anyOf: [{ type: "number", exclusiveMinimum: 0 }, { type: "null" }], default: null },
          enabled: { type: "boolean", default: true },
          points: { type: "array" },
        },
      },
    },
  };

  it("have units, limits and meanings from the schema", () => {
    expect(settings(schema, "wave")).toEqual([
      { key: "wave.impedance_n_s_per_m", kind: "number", unit: "N s/m", scale: 1, label: "impedance", about: "of the line", initial: 2, min: 0.1, max: 5 },
      { key: "wave.filter_s", kind: "number", unit: "ms", scale: 1e3, label: "filter", about: "", initial: null, min: 0 },
      { key: "wave.enabled", kind: "boolean", unit: "", scale: 1, label: "enabled", about: "", initial: true },
    ]);
  });

  it("are empty for what the schema does not have", () => {
    expect(settings(schema, "smith")).toEqual([]);
  });
});
