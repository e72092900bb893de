import { expect, it } from "vitest";
import { feltChannel } from "../src/panels/hand";

it("says that a channel is felt and no force, and what limits it", () => {
  expect(feltChannel(undefined, undefined)).toBe("");
  expect(feltChannel("frequency_shift", "")).toBe("the frequency shift, no force");
  expect(feltChannel("current", "left")).toBe("the current, no force, left");
});
