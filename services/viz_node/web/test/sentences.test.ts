import { readdirSync, readFileSync } from "node:fs";
import { expect, it } from "vitest";
import { eventText, plain, rounded, speaker } from "../src/sentences";
import { fixed, forceText } from "../src/numbers";

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
  expect(eventText("afm_node@slave", "afm_node@slave has ended")).toBe("Tip has ended");
});

it("says what a guard reports in words, whatever its mode and reason", () => {
  expect(eventText("afm_node@slave", "the AFM is in mode retracted: force_limit")).toBe("Tip: it is withdrawn, because the force on the tip was above its limit");
  expect(plain("not armed: the AFM is in mode hold: command_deadline; without fresh commands the tip retracts")).toBe("not armed: it holds its place, because no fresh command came; without fresh commands the tip retracts");
  expect(plain("the AFM is in mode my_mode: my_own_reason")).toBe("it is in mode my mode, because my own reason");
});

it("says keys, nodes and small numbers of the wire in the words of the page, and leaves files alone", () => {
  expect(plain("the set-point 3e-07 N must be below safety.force_limit_n = 2e-07 N")).toBe("the set-point 300 nN must be below safety force limit = 200 nN");
  expect(plain("above lateral.speed_m_per_s = 1e-06 m/s: a dwell of 0.008 s")).toBe("above lateral speed = 1 µm/s: a dwell of 0.008 s");
  expect(plain("set forward.delay_s = 0.4, backward.delay_s = 0.4")).toBe("set forward delay = 0.4 s, backward delay = 0.4 s");
  expect(plain("set lateral.x_m = 3.5e-08, lateral.y_m = -1e-09")).toBe("set lateral x = 35 nm, lateral y = -1 nm");
  expect(plain("afm_node@slave has ended")).toBe("Tip has ended");
  for (const text of ["recording to /home/me/out/fig_12/session_1.mcap", "session_1.mcap is read", "version 0.1.2 stays"]) expect(plain(text)).toBe(text);
});

it("shows no sign of what rounds to none, and no force that nobody feels", () => {
  expect([fixed(-0.004, 2), fixed(-0, 1), fixed(-0.4, 0), fixed(-0.006, 2)]).toEqual(["0.00", "0.0", "0", "-0.01"]);
  expect([forceText(-0.01), forceText(0.012), forceText(-0.02), forceText(NaN)]).toEqual(["0.00", "0.00", "-0.02", "–"]);
});

// every number of the page goes through `fixed`: another way to write one would have a sign of its own
it("writes numbers in one way", () => {
  const files = readdirSync("src", { recursive: true, encoding: "utf8" }).filter((name) => name.endsWith(".ts"));
  expect(files.filter((name) => readFileSync(`src/${name}`, "utf8").includes("toFixed("))).toEqual(["numbers.ts"]);
});

it("who holds control is said without the name of what keeps it", () => {
  expect(plain("Take: acknowledged · lease: window A holds control")).toBe("Take: acknowledged · window A holds control");
  expect(plain("lease: control is free")).toBe("control is free");
});
