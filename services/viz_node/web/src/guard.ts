import type { EventFacts } from "./protocol";

/** What a guard reports: its mode, and why, by their names on the wire. */
export interface GuardReport {
  mode: string;
  reason: string;
}

/** What a mode of the tip is called in a sentence about it. */
const MODES: Record<string, string> = {
  follow: "follows the hand",
  hold: "holds its place",
  retracting: "moves away from the sample",
  retracted: "is withdrawn",
  estop: "is in emergency stop",
};
/** Why the guard of the tip changed its mode, by the name of the reason. */
const REASONS: Record<string, string> = {
  start: "the rig has just started",
  armed: "it was armed",
  estop: "an emergency stop came",
  force_limit: "the force on the tip was above its limit",
  force_invalid: "the force on the tip is not known",
  command_deadline: "no fresh command came",
  hold_expired: "no fresh command came for too long",
  commands_resumed: "commands come again",
  hold_requested: "a command asked for it",
  retract_requested: "a command asked for it",
  device_lost: "the instrument does not answer",
  lateral_limit: "the sideways force on the tip was above its limit",
};
const REPORT = /the AFM is in mode (\w+): (\w+)/;

/** What an event says of the guard; undefined where it says nothing of it. */
export function guardReport(text: string): GuardReport | undefined {
  const found = REPORT.exec(text);
  return found ? { mode: found[1]!, reason: found[2]! } : undefined;
}

/** A reason in words. */
export function reasonText(reason: string): string {
  return REASONS[reason] ?? reason.replaceAll("_", " ");
}

/** An event of the guard in words; every other text as it is. */
export function guardText(text: string): string {
  return text.replace(REPORT, (_, mode: string, reason: string) => `it ${MODES[mode] ?? `is in mode ${mode.replaceAll("_", " ")}`}, because ${reasonText(reason)}`);
}

/** Why the guard has moved the tip away although nobody asked for it; empty where somebody did, or where it is not known. */
export function whyWithdrawn(events: readonly EventFacts[]): string {
  const event = events.findLast(({ text }) => guardReport(text) !== undefined);
  const report = event && guardReport(event.text);
  // of one way to the safe place the reason is the one with which it began
  return report && event.level !== "info" && report.mode.startsWith("retract") ? reasonText(report.reason) : "";
}
