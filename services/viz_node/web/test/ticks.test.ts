import { expect, it } from "vitest";
import { ticks } from "../src/ticks";

it.each([
  [-60, 60, ["-50", "0", "50"]],
  [-1e-4, 6.5e-4, ["0", "0.0002", "0.0004", "0.0006"]],
  [-2.7e-5, 0, ["-2e-5", "-1e-5", "0"]],
  // neighbours never have the same text
  [9.976, 9.984, ["9.976", "9.978", "9.98", "9.982", "9.984"]],
  [8.1599e-3, 8.1601e-3, ["8.1599e-3", "8.16e-3", "8.1601e-3"]],
  // one number tells no scale: a finer step has its turn
  [-1.4, 1.2, ["-1", "0", "1"]],
  [0.2, 4.9, ["2", "4"]],
  [-2450, 150, ["-2000", "-1000", "0"]],
])("are round numbers between %d and %d", (min, max, texts) => {
  const found = ticks(min, max);
  expect(found.map(([, text]) => text)).toEqual(texts);
  found.forEach(([at, text]) => expect(at).toBeCloseTo(Number(text), 9));
});
