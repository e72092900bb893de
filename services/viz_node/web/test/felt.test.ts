import { expect, it } from "vitest";
import { feltAge, feltChannel } from "../src/panels/hand";

it("says that a channel is felt and no force, and what limits it", () => {
  expect(feltChannel(undefined, undefined)).toBe("");
  expect(feltChannel("frequency_shift", "")).toBe("the frequency shift, no force");
  expect(feltChannel("current", "left")).toBe("the current, no force, left");
});

it("says how old the force is that answers the hand, and by which way, as long as answers come", () => {
  const felt = { force_n: 1, age_s: 0.0114, round_trip_s: 0.02, isDatagram: true, at: 5000 };
  expect(feltAge(undefined, 0)).toBe("");
  expect(feltAge(felt, 5000)).toBe("The force is 11 ms old, by datagrams");
  expect(feltAge({ ...felt, isDatagram: false }, 6000)).toBe("The force is 11 ms old, by the web socket");
  expect(feltAge(felt, 6001)).toBe("");
});
