import { expect, it } from "vitest";
import { compact, faultOf } from "../src/field";

it.each([
  ["-5", 0, 2000, "ms", "must be from 0 to 2000 ms"],
  ["99999999", 0, 2000, "ms", "must be from 0 to 2000 ms"],
  ["1e9", undefined, 1e8, "", "must be at most 1e8"],
  ["40ms", 0, 2000, "ms", "40ms is not a number"],
  ["40", 0, 2000, "ms", ""],
  ["", 0, 2000, "ms", ""],
] as const)("says what is wrong with %s", (text, min, max, unit, fault) => {
  expect(faultOf(text, min, max, unit)).toBe(fault);
});

it("takes whole numbers alone where a count is meant", () => {
  expect(faultOf("12.5", 2, 512, "", true)).toBe("must be a whole number");
  expect(faultOf("12", 2, 512, "", true)).toBe("");
});

it("writes a number so that it has room", () => {
  expect([1e8, 0.001, 12.5, 2e-8, 1234567].map(compact)).toEqual(["1e8", "0.001", "12.5", "2e-8", "1234570"]);
});
