import { expect, test } from "vitest";
import { FRAME, PAGE, ageText, agesOf, medianFrame } from "../src/age";

const LOOP: [string, number, number][] = [["law of the master", 0.001, 0.002], ["link there, on purpose", 0.02, 0.02], ["whole", 0.021, 0.022]];

test("the parts are those of the loop, of the way to the page and of a frame, and add up", () => {
  const parts = agesOf(LOOP, 0.061, 0.016);
  expect(parts.map((part) => part.name)).toEqual(["law of the master", "link there, on purpose", PAGE, FRAME]);
  expect(parts.reduce((sum, part) => sum + part.seconds, 0)).toBeCloseTo(0.098, 9);
  expect(ageText(parts).short).toBe("Late most by this page's network: 61 of 98 ms");
  expect(ageText(parts).long).toContain("link there, on purpose 20 ms");
});

test("what is not known is left out", () => {
  expect(agesOf([], 0.061, 0.016)).toEqual([]);
  expect(ageText([]).short).toBe("");
  expect(agesOf(LOOP, NaN, NaN)).toHaveLength(2);
  expect(medianFrame([])).toBeNaN();
  expect(medianFrame([10, 500, 16])).toBe(0.016);
});
