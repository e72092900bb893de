import { expect, it } from "vitest";
import { rumbleStrength, slowText, whyLetGo } from "../src/hand";

it("rumbles in proportion to the force of the tip, whichever way it pushes, and not for noise", () => {
  expect(rumbleStrength(0.01)).toBe(0);
  expect(rumbleStrength(-1.5)).toBeCloseTo(0.5);
  expect(rumbleStrength(1.5)).toBeCloseTo(0.5);
  expect(rumbleStrength(20)).toBe(1);
});

it("lets go where the tip ceases to follow it: in a program, withdrawn, after a stop", () => {
  expect(whyLetGo("follow", "", true)).toBe("");
  // the guard waits for the next command, and follows again
  expect(whyLetGo("hold", "", true)).toBe("");
  expect(whyLetGo("follow", "scan", true)).toBe("the program Image runs");
  for (const mode of ["retracting", "retracted", "estop"]) expect(whyLetGo(mode, "", true)).toBe("the tip was withdrawn");
  expect(whyLetGo("follow", "", false)).toBe("the session has ended");
});

it("says that the page is too slow, with its own age, and nothing where its hand counts", () => {
  expect(slowText(0, 0.1)).toBe("");
  expect(slowText(0.43, NaN)).toBe("Too slow: this page is 430 ms behind, and its force fades");
  expect(slowText(0.43, 0.1)).toBe("Too slow: this page is 480 ms behind, and its force fades");
});
