import type { EventFacts } from "./protocol";
import { fixed } from "./numbers";

/** What the slowest messages take more is said from here on [s]. */
const LEAST_SPREAD_S = 5e-3;

/** One direction of the link, as `link/status` has it. */
export interface Way {
  delay_mean_s?: number;
  delay_max_s?: number;
  delay_valid?: boolean;
  profile?: string;
  settings?: Record<string, unknown>;
}

/** The constant delay of one way that the link is set to [ms], as text; empty where the ways differ or say nothing. */
export function delayText(ways: readonly (Way | undefined)[]): string {
  const [there, back] = ways.map((way) => way?.settings && Number(way.settings["delay_s"] ?? 0));
  return there !== undefined && there === back ? String(+(1e3 * there).toPrecision(6)) : "";
}

/** What the link was measured to do there and back, in a row: means, what the slowest messages took more, and losses. */
export function measuredText(ways: readonly (Way | undefined)[], losses: readonly number[]): string {
  const known = ways.filter((way): way is Way => way?.delay_valid === true);
  if (known.length < 2) return "The network is not measured yet.";
  const sum = (of: (way: Way) => number): number => known.reduce((total, way) => total + of(way), 0);
  const trip = sum((way) => way.delay_mean_s ?? 0);
  const spread = sum((way) => Math.max(0, (way.delay_max_s ?? 0) - (way.delay_mean_s ?? 0)));
  const loss = Math.max(0, ...losses.filter(Number.isFinite));
  const more = spread > LEAST_SPREAD_S ? `, at times ${fixed(spread * 1e3, 0)} ms more` : "";
  return `Measured: ${fixed(trip * 1e3, trip < 0.01 ? 1 : 0)} ms there and back${more}${loss > 0 ? `, ${fixed(100 * loss, loss < 0.1 ? 1 : 0)} % lost` : ""}`;
}

/** The newest warning of an adviser, of the law that is in force or of any; empty where there is none. */
export function adviceIn(events: readonly EventFacts[], law: string): string {
  const newest = events.findLast(({ advises }) => advises !== undefined);
  return newest && [law, ""].includes(newest.advises ?? law) ? newest.text : "";
}

const WAY_NAMES = ["from the master to the slave", "from the slave to the master"];

/** Which way UDP is blocked between two sites and since when (epoch [ns] of each way, by UTC); empty where it is not. */
function blockedText(ways: readonly (readonly unknown[])[]): string {
  const named = ways.flatMap(([, , , since], way) =>
    typeof since === "number" ? [`UDP is blocked ${WAY_NAMES[way]} since ${new Date(since / 1e6).toISOString().slice(11, 19)} UTC`] : [],
  );
  return named.length ? `${named.join(", ")}: the link continues over TCP. ` : "";
}

/** The state of the line between two sites in one row: queue [s], capacity [bit/s], what its receiver takes the other
 * way for, and since when UDP is blocked, of each way; empty if unknown. */
export function lineText(ways: readonly (readonly unknown[])[]): string {
  const queues = ways.map(([queue]) => (typeof queue === "number" ? queue : NaN));
  const blocked = blockedText(ways);
  if (!queues.some(Number.isFinite)) return blocked.trim();
  const carried = ways.map(([, carries]) => (typeof carries === "number" ? (carries * 1e-6).toPrecision(2) : "?"));
  const shown = queues.map((queue) => (Number.isFinite(queue) ? fixed(queue * 1e3, 0) : "?"));
  const full = ways.some(([, , sends]) => sends === "full") ? ": the line is full, and samples are that much older" : "";
  return `${blocked}Line: queue ${shown.join(" and ")} ms, carries ${carried.join(" and ")} Mbit/s${full}`;
}

/** Pictures are taken for those of the loop's own delay within so much of it, or this many milliseconds: their steps are of 5 ms. */
const SAME_SHARE = 0.05;
const SAME_MS = 4;

/** That pictures are of another round trip [ms] than the one in force; nothing where they are of the same. */
export function otherDelay(inForceMs: number, shownMs: number, longestMs: number): string {
  if (Number.isNaN(inForceMs) || Math.abs(inForceMs - shownMs) <= Math.max(SAME_MS, SAME_SHARE * shownMs)) return "";
  const why = inForceMs > longestMs ? `, and none were computed beyond ${longestMs} ms` : "";
  return `The loop runs at ${fixed(inForceMs, 0)} ms: the verdict and the pictures are for another delay, ${shownMs} ms${why}.`;
}
