import { expect, it } from "vitest";
import { oscillationIn } from "../src/oscillation";
import { least, signals } from "./swings.json";

const RATE = 100;

/** A signal of swings.json, at its times. */
function made(parts: readonly number[][]): [times: number[], values: number[]] {
  const times = Array.from({ length: Math.round(parts.at(-1)![1]! * RATE) }, (_, i) => i / RATE);
  const values = times.map((time) => {
    const [from, , level, amplitude, hertz, growth] = parts.findLast((part) => part[0]! <= time + 1e-9) as number[];
    return level! + amplitude! * Math.exp(growth! * (time - from!)) * Math.sin(2 * Math.PI * hertz! * (time - from!));
  });
  return [times, values];
}

it.each(signals)("is found at the end of what swings evenly: $name", ({ parts, now }) => {
  const found = oscillationIn(...made(parts), least);
  if (!now) expect(found).toBeUndefined();
  else {
    expect(found!.hertz / now[0]!).toBeCloseTo(1, 1);
    expect(found!.peakToPeak / now[1]!).toBeCloseTo(1, 0.7);
  }
});

it("is called one with the third even turn, also where a press came just before", () => {
  const [times, values] = made([[0, 2, 0, 0, 0, 0], [2, 12, 2, 0.4, 0.8, 0]]);
  const since = times.findIndex((_, i) => oscillationIn(times.slice(0, i + 1), values.slice(0, i + 1), least) !== undefined);
  const turns = (times[since]! - 2) * 0.8;
  expect(turns).toBeGreaterThan(2.5);
  expect(turns).toBeLessThan(4);
});

it("is found although its peaks differ, as where a hand works against it, and is none of nothing", () => {
  const [times] = made([[0, 6, 0, 0, 0, 0]]);
  const values = times.map((t) => (2 + Math.sin(0.7 * t)) * Math.sin(2 * Math.PI * 1.2 * t) + 0.2 * t);
  expect(oscillationIn(times, values, 0.3)!.hertz).toBeCloseTo(1.2, 1);
  expect(oscillationIn([], [], 0.3)).toBeUndefined();
});
