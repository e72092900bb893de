import { expect, test, vi } from "vitest";
import { FRAME, QUEUE, ageText, agesOf, medianFrame, networkName } from "../src/age";

const LOOP: [string, number, number][] = [["law of the master", 0.001, 0.002], ["link there, on purpose", 0.02, 0.02], ["whole", 0.021, 0.022]];

test("the parts are those of the loop, of the way to the page, of waiting for a picture and of a frame, and add up", () => {
  const parts = agesOf(LOOP, 0.061, 0.034, 0.016);
  expect(parts.map((part) => part.name)).toEqual(["law of the master", "link there, on purpose", "your network", QUEUE, FRAME]);
  expect(parts.reduce((sum, part) => sum + part.seconds, 0)).toBeCloseTo(0.115, 9);
  expect(ageText(parts).short).toBe("Largest part of the latency: your network, 61 of 115 ms");
  expect(ageText(parts).long).toContain("link there, on purpose 20 ms");
});

test("the network is called what the browser says that it is, and is always that of who looks", () => {
  vi.stubGlobal("navigator", { connection: { type: "wifi" } });
  expect(ageText(agesOf(LOOP, 0.061, NaN, 0.008)).short).toBe("Largest part of the latency: your Wi-Fi, 61 of 90 ms");
  vi.unstubAllGlobals();
  expect(networkName({ connection: { type: "cellular" } })).toBe("your mobile network");
  for (const silent of [undefined, {}, { connection: {} }, { connection: { type: "unknown" } }]) expect(networkName(silent)).toBe("your network");
});

test("what is not known is left out", () => {
  expect(agesOf([], 0.061, 0.034, 0.016)).toEqual([]);
  expect(ageText([]).short).toBe("");
  expect(agesOf(LOOP, NaN, NaN, NaN)).toHaveLength(2);
  expect(medianFrame([])).toBeNaN();
  expect(medianFrame([10, 500, 16])).toBe(0.016);
});
