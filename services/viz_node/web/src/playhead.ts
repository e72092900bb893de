/** Samples come in packets: shown this much later [s], the curves move evenly between two of them. */
const LAG_S = 0.05;
/** Further off than this the time jumps, as after a pause [s]. */
const FAR_S = 0.5;
const LONGEST_STEP_S = 0.1;
/** Share of what it is off that is put right in a frame of a sixtieth of a second. */
const GAIN = 0.1;

/** The time up to which curves are drawn: it advances evenly with the display while samples come in packets. */
export class Playhead {
  at = -Infinity;
  private before: number | undefined;

  /**
   * Go on to the time of a frame [ms] and return the place [s], never beyond the newest sample [s].
   * `rate` is what the source plays at: 1 for a running rig, 0 while a recording pauses.
   */
  advance(newest: number, now: number, rate: number): number {
    const step = Math.min(LONGEST_STEP_S, Math.max(0, (now - (this.before ?? now)) / 1e3));
    this.before = now;
    const target = rate ? newest - LAG_S * rate : newest;
    if (!Number.isFinite(newest) || !(Math.abs(target - this.at) < FAR_S * Math.max(1, rate))) return (this.at = target);
    const next = this.at + rate * step + Math.min(1, GAIN * 60 * step) * (target - this.at);
    this.at = Math.min(newest, Math.max(this.at, next));
    return this.at;
  }
}
