import { fixed } from "./numbers";

/** What is older than this is not shown as present [s]. */
export const OLD_S = 0.5;
/** Streams that come this seldom are old only after the time between several of their samples [s]. */
export const SLOW_OLD_S = 2;
/** The clocks of the server and of this page differ by less than this [s/s]; the estimate forgets as quickly. */
const DRIFT = 2e-4;
/** The wall clock runs on while the machine sleeps, and the clock of the page does not: by more than this it has slept [ms]. */
const SLEPT_MS = 400;

/**
 * How old what this page shows is: by the times at which the server sent it, so that a silent line, a queue on the way
 * and a page that stands still all count, and none of them is charged to a node of the rig.
 *
 * The least way of all frames is taken for no way at all: only what a frame took longer than the quickest is age.
 */
export class Freshness {
  /** When the server sent the newest frame that this page has taken in, on its clock [s]; NaN before the first. */
  sentAt = NaN;
  /** When this page took it in [ms]; NaN before the first. */
  private takenAt = NaN;
  private skew = -Infinity;
  private skewAt = 0;
  /** Newest time of any stream minus the time at which the server sent it [s]. */
  private offset = -Infinity;
  private offsetAt = 0;
  private slept = false;
  private wall: number | undefined;

  /** Begin again, as with another server or another recording. */
  begin(): void {
    this.sentAt = NaN;
    this.skew = this.offset = -Infinity;
    this.slept = false;
  }

  /** Take note of a frame that the server sent at a time on its clock [s], at a time of this page [ms], and of the newest sample in it [s]. */
  take(sentAt: number, now: number, newest: number): void {
    // another server has another clock
    if (sentAt < this.sentAt) this.begin();
    this.sentAt = sentAt;
    this.takenAt = now;
    this.slept = false;
    const at = now / 1e3;
    this.skew = Math.max(this.skew - DRIFT * (at - this.skewAt), sentAt - at);
    this.skewAt = at;
    if (!Number.isFinite(newest)) return;
    this.offset = Math.max(this.offset - DRIFT * (sentAt - this.offsetAt), newest - sentAt);
    this.offsetAt = sentAt;
  }

  /** Note the wall clock beside that of the page [ms]: what a machine that slept shows is old until something comes. */
  look(now: number, wall: number): void {
    const ahead = wall - now;
    if (this.wall !== undefined && ahead - this.wall > SLEPT_MS) this.slept = true;
    this.wall = ahead;
  }

  /** How long ago the server sent what this page shows [s]; 0 before anything has come. */
  picture(now: number): number {
    if (Number.isNaN(this.sentAt)) return 0;
    if (this.slept) return Math.max(OLD_S * 2, this.serverAt(now) - this.sentAt);
    return Math.max(0, this.serverAt(now) - this.sentAt);
  }

  /** For how long nothing at all has come [s]: what is old although something comes has waited on its way. */
  silence(now: number): number {
    return Number.isNaN(this.takenAt) ? 0 : Math.max(0, (now - this.takenAt) / 1e3);
  }

  /** How old a sample of this time is [s]; NaN where there is none, 0 before a server has said the time. */
  sample(time: number, now: number): number {
    if (!Number.isFinite(time)) return NaN;
    if (Number.isNaN(this.sentAt)) return 0;
    const newest = this.newest(now);
    return Math.max(this.slept ? OLD_S * 2 : 0, Number.isFinite(newest) ? newest - time : 0);
  }

  /** The time that a sample of this moment would have [s]; -Infinity where it is not known. */
  newest(now: number): number {
    return Number.isNaN(this.sentAt) ? -Infinity : this.serverAt(now) + this.offset;
  }

  private serverAt(now: number): number {
    return now / 1e3 + this.skew;
  }
}

/** An age in words: tenths of a second below ten. */
export function ageWords(age_s: number): string {
  if (age_s < 9.95) return `${fixed(age_s, 1)} s`;
  return age_s < 120 ? `${Math.round(age_s)} s` : `${Math.round(age_s / 60)} min`;
}
