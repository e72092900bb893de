import { expect, it } from "vitest";
import { eventText, rounded, speaker } from "../src/sentences";

it("rounds quantities to three digits, and what is none is 0", () => {
  expect(rounded("the tip is placed: its base is at 1.393e-05 nm")).toBe("the tip is placed: its base is at 0 nm");
  expect(rounded("its base goes from -95.92 nm to -1.7e-6 nm at 2000 nm/s, for 0.048 s")).toBe("its base goes from -95.9 nm to 0 nm at 2000 nm/s, for 0.048 s");
  expect(rounded("2.34567 N peak to peak at 0.776 Hz")).toBe("2.35 N peak to peak at 0.776 Hz");
  expect(rounded("rate 12345.678 Hz, 1e-13 m")).toBe("rate 12300 Hz, 0 m");
});

it("leaves alone what is no quantity: names, versions, whole numbers, other units", () => {
  for (const text of ["afm_node@slave has ended, after 2278 messages", "version 0.1.2 stays", "delay 200 ms one way", "40 N/m of stiffness", "4.25 N/m is stiff", "1.23456 items", "at 12:31:05 UTC"]) expect(rounded(text)).toBe(text);
});

it("says who speaks in the words of the page", () => {
  expect([speaker("afm_node@slave"), speaker("haptic_node@master"), speaker("my_node@slave"), speaker("this page"), speaker("")]).toEqual(["Tip", "Hand", "My node", "This page", ""]);
  expect(eventText("afm_node@slave", "armed at 1e-9 nm")).toBe("Tip: armed at 0 nm");
});
