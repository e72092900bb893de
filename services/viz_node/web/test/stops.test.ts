import { expect, test } from "vitest";
import { Stops } from "../src/stops";

test("an emergency stop of this page ends what was begun before it, and nothing that begins after it", () => {
  const stops = new Stops(() => ({}));
  const before = stops.begin();
  expect(before()).toBe(true);
  stops.note();
  expect(before()).toBe(false);
  expect(stops.begin()()).toBe(true);
});

test("a device that is latched meanwhile ends it, and one that was latched before is what it is there for", () => {
  const latched: Record<string, boolean> = { haptic_node: true, afm_node: true };
  const stops = new Stops(() => ({ ...latched }));
  const arming = stops.begin();
  expect(arming()).toBe(true);
  latched["haptic_node"] = latched["afm_node"] = false;
  expect(arming()).toBe(true);
  const again = stops.begin();
  latched["afm_node"] = true;
  expect(again()).toBe(false);
});
