import { numbers } from "../../kit.js";

export function cueOf(facts) {
  return facts && typeof facts["id"] === "string" ? facts : undefined;
}

/** The request that answers a cue, which had been shown for some time [s]. */
export function answerOf(cue, values, shown_s) {
  const answers = Object.fromEntries(Object.entries(values).map(([name, value]) => [`answer.${name}`, value]));
  return { k: "panel", panel: "experiment", values: { ...answers, cue, shown_s } };
}

const ENGLISH = { language: "en", begin: "Begin", end_rest: "Continue", submit: "Continue", practice: "Practice", trial: "Trial {number} of {total}" };
const RIGHT_TO_LEFT = new Set(["ar", "arc", "ckb", "dv", "fa", "he", "ks", "ps", "sd", "ug", "ur", "yi"]);

/** A word of the page, in the words of the experiment. */
export function label(cue, use) {
  return cue?.labels?.[use] || ENGLISH[use];
}

/** Where the trials are, in words. */
export function countOf(cue) {
  if (cue.practice) return label(cue, "practice");
  const number = Math.min(cue.done + 1, cue.total);
  return label(cue, "trial").replace("{number}", String(number)).replace("{total}", String(cue.total));
}

/** The direction in which a language is written. */
export function directionOf(language) {
  return RIGHT_TO_LEFT.has(language.split("-")[0].toLowerCase()) ? "rtl" : "ltr";
}

export function courseOf(cue) {
  const times = numbers(cue.times_s);
  if (cue.quantity === "none" || !times.length) return undefined;
  return { times, values: numbers(cue.target), width: cue.quantity === "place" ? 2 : 1 };
}

/** The target at a time, linear between its corners, the end values held outside; `axis` 1 is the y of a place. */
export function targetAt(course, time, axis = 0) {
  const { times, values, width } = course;
  const value = (index) => values[index * width + axis];
  let high = 0;
  while (high < times.length && times[high] <= time) high++;
  if (high === 0) return value(0);
  if (high === times.length) return value(high - 1);
  const share = (time - times[high - 1]) / (times[high] - times[high - 1]);
  return value(high - 1) + share * (value(high) - value(high - 1));
}

/** Counts down what is left of a cue between the times at which the server says it [s]; null where it waits. */
export class Remaining {
  id = "";
  endsAt = null;
  begunAt = 0;

  /** Take what the server says now [ms]; whether the cue is another one. */
  take(cue, now) {
    const isNew = cue.id !== this.id;
    const endsAt = cue.remaining_s === null ? null : now + 1e3 * cue.remaining_s;
    // what was on the way longer than usual does not move a countdown back
    if (isNew) this.begunAt = now;
    if (isNew || endsAt === null || this.endsAt === null) this.endsAt = endsAt;
    else this.endsAt = Math.min(this.endsAt, endsAt);
    this.id = cue.id;
    return isNew;
  }

  left(now) {
    return this.endsAt === null ? null : Math.max(0, this.endsAt - now) / 1e3;
  }

  /** How long the cue has been shown here [s]. */
  shown(now) {
    return (now - this.begunAt) / 1e3;
  }
}
