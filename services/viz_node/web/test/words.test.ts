import { expect, it } from "vitest";
import { adviceIn, delayText, lineText, measuredText, otherDelay } from "../src/link";
import type { EventFacts } from "../src/protocol";
import { noMoment, withoutReleased, type Hold } from "../src/document";
import { energyText } from "../src/panels/law";
import { judged } from "../src/panels/nodes";

const way = (delay_mean_s: number, delay_max_s = delay_mean_s): object => ({ delay_mean_s, delay_max_s, delay_valid: true });

it.each([
  [[way(0.0001), way(0.0001)], [0, 0], "Measured: 0.2 ms there and back"],
  [[way(0.1), way(0.1)], [0, 0], "Measured: 200 ms there and back"],
  [[way(0.01, 0.06), way(0.01)], [0, 0], "Measured: 20 ms there and back, at times 50 ms more"],
  [[way(0.01), way(0.01)], [0.05, 0], "Measured: 20 ms there and back, 5.0 % lost"],
  [[undefined, undefined], [], "The network is not measured yet."],
])("says what a network was measured to do, and judges nothing", (ways, losses, sentence) => {
  expect(measuredText(ways, losses)).toBe(sentence);
});

it("shows the newest warning of an adviser, of the law that is in force", () => {
  const event = (text: string, advises?: string): EventFacts => ({ src: "launcher@master", seq: 0, t: 0, kind: "node", level: "warning", text, ...(advises !== undefined && { advises }) });
  const events = [event("older", "wave"), event("The line is outside", "virtual_impedance"), event("a node is late")];
  expect(adviceIn(events, "virtual_impedance")).toBe("The line is outside");
  // after a change of the law the warning is of another one
  expect(adviceIn(events, "wave")).toBe("");
  expect(adviceIn([event("a node is late")], "wave")).toBe("");
  expect(adviceIn([event("for any law", "")], "wave")).toBe("for any law");
});

it("shows the delay that the link is set to, where it is the same both ways", () => {
  const at = (delay_s?: number): object => ({ settings: delay_s === undefined ? {} : { delay_s } });
  expect(delayText([at(0.2), at(0.2)])).toBe("200");
  expect(delayText([at(), at(0)])).toBe("0");
  expect(delayText([at(0.2), at(0.1)])).toBe("");
  expect(delayText([undefined, at(0.1)])).toBe("");
});

it("says in a row what the line between two sites does", () => {
  expect(lineText([[undefined, undefined], [undefined, undefined]])).toBe("");
  expect(lineText([[0.001, 1e7], [0, 1e6]])).toBe("Line: queue 1 and 0 ms, carries 10 and 1.0 Mbit/s");
  expect(lineText([[0.052, 1e6], [undefined, null, "full"]])).toMatch(/52 and \? ms, carries 1\.0 and \? Mbit\/s: the line is full/);
  const since = Date.UTC(2026, 10, 26, 12, 31, 5) * 1e6;
  expect(lineText([[0.001, 1e7, "free", null], [0, 1e6, "free", since]])).toBe(
    "UDP is blocked from the slave to the master since 12:31:05 UTC: the link continues over TCP. Line: queue 1 and 0 ms, carries 10 and 1.0 Mbit/s",
  );
  expect(lineText([[null, null, "free", since], [null, null, "free", null]])).toBe("UDP is blocked from the master to the slave since 12:31:05 UTC: the link continues over TCP.");
  // A delay that its sender does not take for a queue is none.
  expect(lineText([[0.052, 1e6, "free"], [0.03, 1e6, "shared"]])).toBe("Line: queue 52 and 30 ms, carries 1.0 and 1.0 Mbit/s");
});

it("judges the numbers of a node in words", () => {
  const node = { state: "running", overruns: 15, lost: 0, rejected: 26, lateness_p99_s: 1e-4, uptime_s: 60, rate_hz: 1000 };
  expect(judged(node)).toEqual(["", "good (15 late, 26 outdated refused)"]);
  expect(judged({ ...node, overruns: 5000 })[0]).toBe("warn");
  expect(judged({ ...node, lateness_p99_s: 0.02 })).toEqual(["warn", "late"]);
  // half of a period is late for a node of twenty messages a second
  expect(judged({ ...node, overruns: 0, rate_hz: 20, lateness_p99_s: 0.015 })[0]).toBe("");
  expect(judged({ ...node, state: "safe" })[0]).toBe("warn");
  expect(judged({ ...node, state: "safe" }, true)).toEqual(["", "idle while the instrument runs a program"]);
  expect(judged({ ...node, overruns: 0, rejected: 0 })).toEqual(["", "good"]);
});

it("says that no event comes only as far as the recording is read", () => {
  expect(noMoment(true, 0.012)).toBe("No later event (read so far: 1 %)");
  expect(noMoment(false, 1)).toBe("No earlier event");
  expect(noMoment(true, 0.9995)).toMatch(/^No later event \(all is read/);
});

it("calls a hold in which nobody presses released, and leaves every other verdict", () => {
  const hold = (hand_force_n: number, verdict: string): Hold => ({ from_s: 0, to_s: 1, hand_force_n, verdict, reason: "", growth_per_s: null, peak_to_peak_n: 0 });
  const verdicts = (holds: Hold[]): string[] => withoutReleased(holds).map(({ verdict }) => verdict);
  expect(verdicts([hold(1, "stable"), hold(0, "stable"), hold(0.04, "stable"), hold(0.06, "stable"), hold(0, "limit_cycle")])).toEqual(["stable", "released", "released", "stable", "limit_cycle"]);
  expect(verdicts([hold(0, "stable")])).toEqual(["released"]);
});

it("names pictures of another delay than the one in force", () => {
  expect(otherDelay(401, 200, 200)).toBe("The loop runs at 401 ms: the verdict and the pictures are for another delay, 200 ms, and none were computed beyond 200 ms.");
  expect(otherDelay(60, 120, 200)).toBe("The loop runs at 60 ms: the verdict and the pictures are for another delay, 120 ms.");
  // the nearest of steps of 5 ms is the same
  for (const [inForce, shown] of [[62.4, 60], [1.2, 0], [203, 200], [NaN, 40]] as const) expect(otherDelay(inForce, shown, 200)).toBe("");
});

it("says where a motion gets its energy that swings although the loop makes none", () => {
  expect([energyText(true), energyText(true, true), energyText(false, true), energyText(undefined, true)]).toEqual(["adds no energy", "adds none: the hand's energy keeps it swinging", "has added energy", ""]);
});
