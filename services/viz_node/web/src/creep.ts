import { fixed } from "./numbers";

/** A hand that moves by less than this in the time that is looked at rests [m]. */
const RESTS_M = 2e-6;
/** A hand that is pressed with more than this is not free [N]. */
const PRESSED_N = 0.02;

/**
 * Why a hand that nobody holds moves all the same, in words; empty where it rests, or somebody presses it.
 *
 * `moved_m`: how far it went towards the sample in `over_s`; `own_n`: what presses it; `tip_n`: the force of the tip at
 * the hand's scale, which draws it towards the sample where it is negative.
 */
export function creepText(moved_m: number, over_s: number, own_n: number, tip_n: number): string {
  if (!(Math.abs(moved_m) >= RESTS_M) || !(over_s > 0) || Math.abs(own_n) > PRESSED_N) return "";
  const perMinute = (60 * 1e3 * Math.abs(moved_m)) / over_s;
  const speed = perMinute >= 60 ? `${fixed(perMinute / 60, 1)} mm a second` : `${fixed(perMinute, perMinute < 1 ? 2 : 1)} mm a minute`;
  const force = Math.abs(tip_n) < 1e-4 ? "" : ` with ${Math.abs(tip_n) < 0.1 ? `${(1e3 * Math.abs(tip_n)).toPrecision(2)} mN` : `${fixed(Math.abs(tip_n), 2)} N`}`;
  const isDrawn = moved_m > 0 && tip_n < 0;
  const isPushed = moved_m < 0 && tip_n > 0;
  if (isDrawn) return `Nobody holds the hand: the tip draws it down${force}, ${speed}. Hold it, and it stays`;
  if (isPushed) return `Nobody holds the hand: the sample pushes it up${force}, ${speed}. Hold it, and it stays`;
  return `Nobody holds the hand: it drifts ${moved_m > 0 ? "down" : "up"} by itself, ${speed}. Hold it, and it stays`;
}
