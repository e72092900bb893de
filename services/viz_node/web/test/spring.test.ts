import { expect, it } from "vitest";
import type { Snapshot, Tick } from "../src/protocol";
import { KEPT_DEADLINE_MS, LIMIT_N, PAGE_DEADLINE_MS, Spring, springForce } from "../src/spring";

const column = (name: string): { name: string; unit: string; about: string } => ({ name, unit: "", about: "" });
const SNAPSHOT = { k: "snapshot", streams: [{ name: "hand", topic: "haptic/state", columns: [column("force"), column("position")] }] } as unknown as Snapshot;

/** Two samples: times, forces that are none of an arm, positions [m]. */
function tick(...positions: number[]): Tick {
  const numbers = Float32Array.from([...positions.map((_, i) => i * 1e-3), ...positions.map(() => 99), ...positions]);
  return { k: "tick", streams: { hand: { n: positions.length, t0: 0, data: new Uint8Array(numbers.buffer) } } };
}

function held(...positions: number[]): Spring {
  const spring = new Spring();
  spring.take(SNAPSHOT);
  spring.take(tick(...positions));
  spring.mean(0.01, false, 0);
  return spring;
}

it("pulls the arm to where the hand means to be, and no harder than its limit", () => {
  expect(springForce(0.01, 0.005)).toBeCloseTo(1);
  expect(springForce(-0.01, 0.005)).toBeCloseTo(-3);
  expect(springForce(1, 0)).toBe(LIMIT_N);
  expect(springForce(-1, 0)).toBe(-LIMIT_N);
});

it("goes by the newest place of the arm, although the page says nothing new", () => {
  const spring = held(0.001, 0.002);
  expect(spring.next(10)).toBeCloseTo(1.6, 5);
  spring.take(tick(0.004, 0.006));
  expect(spring.next(20)).toBeCloseTo(0.8, 5);
  spring.take(tick(NaN));
  expect(spring.next(30)).toBeCloseTo(0.8, 5);
});

it("lets go once when the page does", () => {
  const spring = held(0);
  expect(spring.next(10)).toBe(2);
  spring.mean(null, false, 15);
  expect([spring.next(15), spring.next(30)]).toEqual([null, undefined]);
});

it("lets go of a page that stands still, and holds again when it goes on", () => {
  const spring = held(0);
  expect(spring.next(PAGE_DEADLINE_MS - 1)).toBe(2);
  expect(spring.next(PAGE_DEADLINE_MS)).toBe(null);
  expect(spring.next(PAGE_DEADLINE_MS + 15)).toBe(undefined);
  spring.mean(0.01, false, PAGE_DEADLINE_MS + 20);
  expect(spring.next(PAGE_DEADLINE_MS + 30)).toBe(2);
});

it("holds on for longer where the hand is kept without a pointer", () => {
  const spring = held(0);
  spring.mean(0.01, true, 0);
  expect(spring.next(KEPT_DEADLINE_MS - 1)).toBe(2);
  expect(spring.next(KEPT_DEADLINE_MS)).toBe(null);
});

it("does not push before it knows where the arm is, nor by what it knew of a server before", () => {
  const spring = new Spring();
  spring.take(SNAPSHOT);
  spring.mean(0.01, false, 0);
  expect(spring.next(10)).toBe(undefined);
  spring.take(tick(0));
  expect(spring.next(20)).toBe(2);
  spring.take(SNAPSHOT);
  expect(spring.next(30)).toBe(null);
});

it("pulls across the sample as well, and without pressing where the page means only that", () => {
  const spring = new Spring();
  spring.take({ k: "snapshot", streams: [{ name: "hand", topic: "haptic/state", columns: ["position", "x", "y"].map(column) }] } as unknown as Snapshot);
  const numbers = Float32Array.from([0, 0.004, 0.001, -0.002]);
  spring.take({ k: "tick", streams: { hand: { n: 1, t0: 0, data: new Uint8Array(numbers.buffer) } } });
  spring.mean(null, false, 0, [0.011, -0.002]);
  expect(spring.next(10)).toBe(0);
  expect(spring.acrossForce[0]).toBeCloseTo(2, 5);
  expect(spring.acrossForce[1]).toBeCloseTo(0, 5);
  spring.mean(null, false, 15, null);
  expect(spring.next(15)).toBe(null);
  expect(spring.acrossForce).toEqual([0, 0]);
});
