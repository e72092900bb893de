import { fixed } from "./numbers";

/** A limit that acts: where it is shown, and what leads away from it. */
export interface Limit {
  words: string;
  /** What a person does about it. */
  out: string;
}

const limit = (words: string, out: string): Limit => ({ words, out });

/** Each limit that the hand reports in `limited_by` of haptic/state. */
export const HAND_LIMITS: Record<string, Limit> = {
  travel: limit("the hand is at the end of its travel", "lift it"),
  end_stop: limit("the hand is at its end stop", "lift it"),
  force: limit("the hand gives all the force that it may", "press less, or lift it"),
  operator_force: limit("you press with all the force that counts", "press less"),
  torque: limit("the motor of the hand is at its greatest torque", "press less"),
  voltage: limit("the motor of the hand is at its greatest voltage", "move more slowly"),
  speed: limit("the hand follows at its greatest speed", "move more slowly, or wait"),
};

/** Each limit that the instrument reports in `limited_by` of afm/state. */
export const TIP_LIMITS: Record<string, Limit> = {
  range: limit("the drive of the tip is at the end of its range", "move the hand the other way"),
  area: limit("the tip is at the edge of the area that it reaches", "move it back over the sample"),
  speed: limit("the tip follows at its greatest speed", "move more slowly, or wait"),
  lateral_speed: limit("the tip crosses the sample at its greatest speed", "move more slowly, or wait"),
};

/** What limits the channel that is felt instead of a force, `felt_clamp` of afm/state. */
export const FELT_LIMITS: Record<string, Limit> = {
  saturated: limit("the input of what is felt is at its end", "lift the hand"),
  bounds: limit("what is felt is at the bound that was set for it", "lift the hand"),
  rate: limit("what is felt changes faster than it may", "move more slowly"),
  left: limit("what is felt has left its table", "lift the hand until it is back"),
};

/** The limits that act, by what hand and instrument report; none of a tip that is on its way, whose speed is chosen. */
export function limitsOf(hand: unknown, tip: unknown, clamp: unknown, placed: boolean): Limit[] {
  const found = [HAND_LIMITS[String(hand)], placed || !String(tip).endsWith("speed") ? TIP_LIMITS[String(tip)] : undefined, FELT_LIMITS[String(clamp)]];
  return found.filter((each) => each !== undefined);
}

/** The limits that act, in a sentence; empty where none does. */
export function limitsText(limits: readonly Limit[]): string {
  return limits.map(({ words, out }) => `${words[0]!.toUpperCase()}${words.slice(1)}: ${out}`).join(". ");
}

/** What the hand has left of its travel towards the sample, in words, and both ways; empty where it is not known [m]. */
export function travelText(position_m: number, travel_m: readonly [number, number] | undefined): { short: string; long: string } {
  if (!travel_m || Number.isNaN(position_m)) return { short: "", long: "" };
  const [up, down] = [position_m - travel_m[0], travel_m[1] - position_m].map((way) => fixed(Math.max(0, way) * 1e3, 1));
  return { short: `${down} mm left`, long: `The hand can still go ${down} mm down and ${up} mm up` };
}
