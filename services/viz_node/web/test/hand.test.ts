import { expect, it } from "vitest";
import { rumbleStrength } from "../src/hand";

it("rumbles in proportion to the force of the tip, whichever way it pushes, and not for noise", () => {
  expect(rumbleStrength(0.01)).toBe(0);
  expect(rumbleStrength(-1.5)).toBeCloseTo(0.5);
  expect(rumbleStrength(1.5)).toBeCloseTo(0.5);
  expect(rumbleStrength(20)).toBe(1);
});
