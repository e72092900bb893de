/** One part of the age of what is felt at this page [s]. */
export interface AgePart {
  name: string;
  seconds: number;
}

const NETWORKS: Record<string, string> = { wifi: "your Wi-Fi", cellular: "your mobile network", ethernet: "your cable" };

/** Whose network the way to this page is, by what the browser says that it is connected by; most browsers do not say. */
export function networkName(browser: unknown = globalThis.navigator): string {
  const type = (browser as { connection?: { type?: string } } | undefined)?.connection?.type ?? "";
  return NETWORKS[type] ?? "your network";
}

export const QUEUE = "queue for the next picture of the rig";
export const FRAME = "frame of this page";
const LAST_FRAMES = 60;

/** The middle one of the last times between two frames, or two pictures of the rig: from [ms] to [s]. */
export function medianFrame(frames: readonly number[]): number {
  const last = frames.slice(-LAST_FRAMES).sort((a, b) => a - b);
  return last.length ? last[last.length >> 1]! / 1e3 : NaN;
}

/**
 * The age of what is felt at a page by its parts: those of the loop, the way to the page and back, over which force and
 * answer go, half of the time between two pictures of the rig, for which what happened waits on average until it is
 * sent, and a frame of the page, as requestAnimationFrame has it.
 */
export function agesOf(loop: readonly [string, number, number][], wayS: number, pictureS: number, frameS: number): AgePart[] {
  if (loop.length < 2) return [];
  const parts = loop.slice(0, -1).map(([name, seconds]) => ({ name, seconds }));
  if (Number.isFinite(wayS)) parts.push({ name: networkName(), seconds: wayS });
  if (Number.isFinite(pictureS)) parts.push({ name: QUEUE, seconds: pictureS / 2 });
  if (Number.isFinite(frameS)) parts.push({ name: FRAME, seconds: frameS });
  return parts;
}

const ms = (seconds: number): string => (1e3 * seconds).toPrecision(seconds < 0.01 ? 2 : 3).replace(/\.0+$/, "");

/** The largest part in words, and all of them; empty where nothing is known. */
export function ageText(parts: readonly AgePart[]): { short: string; long: string } {
  if (!parts.length) return { short: "", long: "" };
  const whole = parts.reduce((sum, part) => sum + part.seconds, 0);
  const largest = parts.reduce((best, part) => (part.seconds > best.seconds ? part : best));
  const named = parts.filter((part) => part.seconds > 5e-5).map((part) => `${part.name} ${ms(part.seconds)} ms`);
  return { short: `Largest part of the latency: ${largest.name}, ${ms(largest.seconds)} of ${ms(whole)} ms`, long: named.join(", ") };
}
