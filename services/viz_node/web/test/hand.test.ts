import { expect, it } from "vitest";
import { LIMIT_N, rumbleStrength, springForce } from "../src/hand";

it("pulls the arm to where the hand means to be, and no harder than its limit", () => {
  expect(springForce(0.01, 0.005)).toBeCloseTo(1);
  expect(springForce(-0.01, 0.005)).toBeCloseTo(-3);
  expect(springForce(1, 0)).toBe(LIMIT_N);
  expect(springForce(-1, 0)).toBe(-LIMIT_N);
});

it("rumbles in proportion to the force of the tip, whichever way it pushes, and not for noise", () => {
  expect(rumbleStrength(0.01)).toBe(0);
  expect(rumbleStrength(-1.5)).toBeCloseTo(0.5);
  expect(rumbleStrength(1.5)).toBeCloseTo(0.5);
  expect(rumbleStrength(20)).toBe(1);
});
