import { expect, it } from "vitest";
import { oscillationIn } from "../src/oscillation";

const times = Float64Array.from({ length: 600 }, (_, i) => i / 100);
const sine = (hertz: number, amplitude: number): Float64Array => times.map((t) => 1 + amplitude * Math.sin(2 * Math.PI * hertz * t));

it("is found with how often and how far", () => {
  const found = oscillationIn(times, sine(1.5, 2), 0.3)!;
  expect(found.hertz).toBeCloseTo(1.5, 1);
  expect(found.peakToPeak).toBeCloseTo(4, 1);
});

it("is found although its peaks differ, as where a hand works against it", () => {
  const found = oscillationIn(times, times.map((t) => (2 + Math.sin(0.7 * t)) * Math.sin(2 * Math.PI * 1.2 * t) + 0.2 * t), 0.3)!;
  expect(found.hertz).toBeCloseTo(1.2, 1);
});

it("is none that nobody feels, none that has come to rest, and no hand that works", () => {
  expect(oscillationIn(times, sine(1.5, 0.1), 0.3)).toBeUndefined();
  expect(oscillationIn(times, sine(2, 1).map((value, i) => (i < 250 ? value : 1)), 0.3)).toBeUndefined();
  // presses of a person, at times that are not even
  const presses = times.map((t) => ([[0.2, 0.5], [0.9, 1.1], [1.4, 1.5], [2.9, 3.9], [4.1, 4.3], [5.8, 5.9]].some(([from, to]) => t > from! && t < to!) ? 1 : 0));
  expect(oscillationIn(times, presses, 0.3)).toBeUndefined();
  expect(oscillationIn([], [], 0.3)).toBeUndefined();
});
