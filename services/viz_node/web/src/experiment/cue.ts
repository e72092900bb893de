import { numbers, type Facts, type WireArray } from "../protocol";

/** A question: a choice where there are options, else a scale. */
export interface Question {
  name: string;
  text: string;
  low: string;
  high: string;
  least: number;
  most: number;
  step: number;
  options: string[];
}

export type Stage = "consent" | "instruction" | "countdown" | "trial" | "rest" | "question" | "pause" | "end";
export type Quantity = "none" | "force" | "position" | "place";

/** What a participant sees and is asked now (experiment/cue of the bus). */
export interface Cue {
  id: string;
  stage: Stage;
  title: string;
  text: string;
  remaining_s: number | null;
  done: number;
  total: number;
  practice: boolean;
  /** Own words of the page by their use; English where there is none. */
  labels: Record<string, string>;
  quantity: Quantity;
  band: number;
  times_s: WireArray;
  target: WireArray;
  questions: Question[];
}

/** The target of a trial: times [s], and values of one or two dimensions one after the other. */
export interface Course {
  times: ArrayLike<number>;
  values: ArrayLike<number>;
  width: 1 | 2;
}

export function cueOf(facts: Facts | undefined): Cue | undefined {
  return facts && typeof facts["id"] === "string" ? (facts as unknown as Cue) : undefined;
}

const ENGLISH = { language: "en", begin: "Begin", go_on: "Go on", submit: "Continue", practice: "Practice", trial: "Trial {number} of {total}" };
const RIGHT_TO_LEFT = new Set(["ar", "arc", "ckb", "dv", "fa", "he", "ks", "ps", "sd", "ug", "ur", "yi"]);

/** A word of the page, in the words of the experiment. */
export function label(cue: Cue | undefined, use: keyof typeof ENGLISH): string {
  return cue?.labels?.[use] || ENGLISH[use];
}

/** Where the trials are, in words. */
export function countOf(cue: Cue): string {
  if (cue.practice) return label(cue, "practice");
  const number = Math.min(cue.done + 1, cue.total);
  return label(cue, "trial").replace("{number}", String(number)).replace("{total}", String(cue.total));
}

/** The direction in which a language is written. */
export function directionOf(language: string): "ltr" | "rtl" {
  return RIGHT_TO_LEFT.has(language.split("-")[0]!.toLowerCase()) ? "rtl" : "ltr";
}

export function courseOf(cue: Cue): Course | undefined {
  const times = numbers(cue.times_s);
  if (cue.quantity === "none" || !times.length) return undefined;
  return { times, values: numbers(cue.target), width: cue.quantity === "place" ? 2 : 1 };
}

/** The target at a time, linear between its corners, the end values held outside; `axis` 1 is the y of a place. */
export function targetAt(course: Course, time: number, axis: 0 | 1 = 0): number {
  const { times, values, width } = course;
  const value = (index: number): number => values[index * width + axis]!;
  let high = 0;
  while (high < times.length && times[high]! <= time) high++;
  if (high === 0) return value(0);
  if (high === times.length) return value(high - 1);
  const share = (time - times[high - 1]!) / (times[high]! - times[high - 1]!);
  return value(high - 1) + share * (value(high) - value(high - 1));
}

/** Counts down what is left of a cue between the times at which the server says it [s]; null where it waits. */
export class Remaining {
  private id = "";
  private endsAt: number | null = null;
  private begunAt = 0;

  /** Take what the server says now [ms]; whether the cue is another one. */
  take(cue: Cue, now: number): boolean {
    const isNew = cue.id !== this.id;
    const endsAt = cue.remaining_s === null ? null : now + 1e3 * cue.remaining_s;
    // what was on the way longer than usual does not move a countdown back
    if (isNew) this.begunAt = now;
    if (isNew || endsAt === null || this.endsAt === null) this.endsAt = endsAt;
    else this.endsAt = Math.min(this.endsAt, endsAt);
    this.id = cue.id;
    return isNew;
  }

  left(now: number): number | null {
    return this.endsAt === null ? null : Math.max(0, this.endsAt - now) / 1e3;
  }

  /** How long the cue has been shown here [s]. */
  shown(now: number): number {
    return (now - this.begunAt) / 1e3;
  }
}
