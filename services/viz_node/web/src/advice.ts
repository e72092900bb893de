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

/** Round trips up to which a law holds the hold of Fig. 12 in the maps of docs/laws.md [s]. */
const BARE_S = 0.045;
/** Mean delay in which a spread is felt as roughness. */
const JITTER_SHARE = 0.5;
const LOSS_FELT = 0.02;

/**
 * What to do on a network as it is measured, in one sentence; `telenano study advise` computes the rest.
 * Parameters: the two ways, the share that each lost lately, and the law in force.
 */
export function adviceFor(ways: readonly (Way | undefined)[], losses: readonly number[], law: string): string {
  const known = ways.filter((way): way is Way => way?.delay_valid === true);
  if (known.length < 2) return "The network is not measured yet.";
  const trip = known.reduce((sum, way) => sum + (way.delay_mean_s ?? 0), 0);
  const spread = known.reduce((sum, way) => sum + Math.max(0, (way.delay_max_s ?? 0) - (way.delay_mean_s ?? 0)), 0);
  const loss = Math.max(0, ...losses.filter(Number.isFinite));
  const measured = `${(trip * 1e3).toFixed(trip < 0.01 ? 1 : 0)} ms there and back${loss > 0 ? `, ${(100 * loss).toFixed(loss < 0.1 ? 1 : 0)} % lost` : ""}`;
  const isGuarded = /wave|passivity|model/.test(law);
  if (trip > BARE_S && !isGuarded) return `${measured}: take the law wave or passivity, ${law.replaceAll("_", " ") || "this one"} may oscillate.`;
  if (spread > JITTER_SHARE * trip && spread > 5e-3) return `${measured}, and up to ${(spread * 1e3).toFixed(0)} ms more: expect a rough touch, and press softly.`;
  if (loss > LOSS_FELT) return `${measured}: expect gaps in what you feel.`;
  if (trip > BARE_S) return `${measured}: ${law.replaceAll("_", " ")} suits it, and the sample feels softer.`;
  return `${measured}: any law suits it.`;
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
  const shown = queues.map((queue) => (Number.isFinite(queue) ? (queue * 1e3).toFixed(0) : "?"));
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
  return `The loop runs at ${inForceMs.toFixed(0)} ms: verdict and pictures are of another delay, ${shownMs} ms${why}.`;
}
