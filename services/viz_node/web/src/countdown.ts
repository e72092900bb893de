import { fixed } from "./numbers";

/** How far a motion of known length is. */
export interface Countdown {
  left_s: number;
  /** What of it is over, from 0 to 1. */
  share: number;
  text: string;
}

/** The countdown of a motion that began at a time and takes so long; it never goes below 0, and a length of 0 is over. */
export function countdown(begun_ms: number, length_s: number, now_ms: number): Countdown {
  const left_s = Math.min(length_s, Math.max(0, length_s - (now_ms - begun_ms) / 1e3));
  const share = length_s > 0 ? 1 - left_s / length_s : 1;
  return { left_s, share, text: left_s > 0 ? `${fixed(left_s, 1)} s left` : "arriving" };
}
