import type { Cockpit, Panel } from "../cockpit";
import type { Hold } from "../document";
import { make } from "../dom";
import { fixed } from "../numbers";

/** Keys of summary.json in the order in which they are read, with what they are called. */
const ROWS: readonly (readonly [key: string, name: string, show: (value: never) => string])[] = [
  ["scenario", "Scenario", String],
  ["law", "Law", (law: string[]) => law.join(", ").replaceAll("_", " ")],
  ["verdict", "Verdict", (text: string) => text.replaceAll("_", " ")],
  ["hold_ratio", "Hold ratio", (value: number) => fixed(value, 3)],
  ["contact_x_cm", "Hand reference at the end", (value: number) => `${fixed(value, 3)} cm`],
  ["release_force_nn", "Force after release", (value: number) => `${fixed(value, 2)} nN`],
  ["greatest_pull_nn", "Greatest pull", (value: number) => `${fixed(value, 2)} nN`],
  ["loop_round_trip_ms", "Round trip of the loop", (value: number) => `${fixed(value, 1)} ms`],
  ["link_round_trip_range_ms", "Round trip of the link", (value: [number, number]) => rangeText(value)],
  ["loop_age_ms", "Loop age, 50 and 99 %", (age: { p50: number; p99: number }) => `${fixed(age.p50, 2)}, ${fixed(age.p99, 2)} ms`],
  ["recording", "Recording", (recording: RecordingAccount) => accountText(recording)],
  ["interruptions", "Interruptions", (all: { kind: string }[]) => interruptionsText(all)],
  ["overruns", "Deadlines missed", String],
  ["hand_cycles", "Cycles of the hand", String],
  ["duration_s", "Duration", (value: number) => `${fixed(value, 1)} s`],
  ["version", "Version", String],
];

/** Which messages that were sent a recording lacks, as `summary.json` says it. */
export interface RecordingAccount {
  complete: boolean;
  missing: string[];
}

/** Whether a recording has all that was sent, or else what it lacks. */
export function accountText({ complete, missing }: RecordingAccount): string {
  return complete ? "whole" : `not whole: ${missing.join("; ")}`;
}

export const INTERRUPTIONS: Record<string, string> = { process_ended: "a process ended", source_silent: "hand or AFM sent nothing", tip_held: "the tip was held", hand_let_go: "the hand was let go" };

/** What interrupted a session, each kind with how often. */
export function interruptionsText(all: readonly { kind: string }[]): string {
  const kinds = [...new Set(all.map(({ kind }) => kind))];
  const times = (kind: string): number => all.filter((one) => one.kind === kind).length;
  return kinds.map((kind) => `${INTERRUPTIONS[kind] ?? kind.replaceAll("_", " ")}${times(kind) > 1 ? ` (${times(kind)} times)` : ""}`).join(", ") || "none";
}

/** The share of a hold in which hand and tip were coupled; empty where it is all of it. */
export function coupledText({ coupled_share: share = 1 }: Pick<Hold, "coupled_share">): string {
  return share > 0.995 ? "" : `, hand and tip coupled for ${Math.round(100 * share)} %`;
}

/** More holds of which there is nothing to say are one row. */
const MOST_QUIET = 6;
const VERDICTS = { good: "good", warn: "warn", bad: "error" };

/** Whether a verdict is good, bad, or none that says so. */
export function kindOf(verdict: string): "good" | "warn" | "bad" {
  if (verdict === "stable") return "good";
  return ["cannot_say", "no_data", "released"].includes(verdict) ? "warn" : "bad";
}

/** The facts of a hold that somebody has to know of who sees that it is stable. */
export function warnings({ facts }: Pick<Hold, "facts">): string[] {
  return (facts ?? []).filter(({ kind }) => !["arrived_late", "contact_by_force"].includes(kind)).map(({ text }) => text);
}

/** Least and greatest of what may have been changed [ms]: one number where it stayed as it was. */
export function rangeText([least, greatest]: readonly [number, number]): string {
  return greatest - least < 1 ? `${fixed((least + greatest) / 2, 1)} ms` : `${fixed(least, 1)} to ${fixed(greatest, 1)} ms`;
}

/** The holds that say something, and how many of the others there are of each kind. */
export function sorted(holds: readonly Hold[]): { notable: Hold[]; others: Hold[]; words: string } {
  const isQuiet = (hold: Hold): boolean => (hold.verdict === "stable" || hold.verdict === "released") && !hold.frequency_hz && !warnings(hold).length;
  const others = holds.filter(isQuiet);
  if (others.length <= MOST_QUIET) return { notable: [...holds], others: [], words: "" };
  const count = (kind: string): string => {
    const found = others.filter(({ verdict }) => verdict === kind).length;
    return found ? `${found} ${kind}` : "";
  };
  return { notable: holds.filter((hold) => !isQuiet(hold)), others, words: [count("stable"), count("released")].filter(Boolean).join(", ") };
}

/** The verdict on a recording and on each of its holds, with the numbers of its summary. */
export class SummaryPanel implements Panel {
  private readonly verdict = make("p");
  private readonly holds = make("tbody");
  private readonly facts = make("dl", { class: "facts" });
  private readonly table: HTMLElement;
  private shown = -1;

  constructor(
    root: HTMLElement,
    private readonly cockpit: Cockpit,
  ) {
    const head = ["from, s", "hand, N", "p–p, N", "verdict"].map((name) => make("th", { scope: "col" }, name));
    this.table = make("table", { class: "holds" }, make("thead", {}, make("tr", {}, ...head)), this.holds);
    root.append(this.verdict, this.table, this.facts);
  }

  write(): void {
    const { document } = this.cockpit;
    if (document.version === this.shown) return;
    this.shown = document.version;
    const { about } = document;
    const summary = about?.summary as Record<string, unknown> | null | undefined;
    this.facts.hidden = !summary;
    this.table.hidden = !summary || !about?.holds?.length;
    if (!summary) {
      const { progress } = document;
      this.verdict.textContent = about?.fault ?? (progress ? `${progress[0]!.toUpperCase()}${progress.slice(1)}. The verdict comes at the end.` : "There is no verdict.");
      return;
    }
    this.verdict.replaceChildren(make("b", { class: VERDICTS[kindOf(String(summary["verdict"]))] }, String(summary["verdict"]).replaceAll("_", " ")), `: ${String(summary["reason"])}`);
    this.fill(about?.holds ?? []);
    const rows = ROWS.filter(([key]) => summary[key] !== null && summary[key] !== undefined);
    this.facts.replaceChildren(...rows.flatMap(([key, name, show]) => [make("dt", {}, name), make("dd", {}, show(summary[key] as never))]));
  }

  private fill(holds: readonly Hold[]): void {
    const { notable, others, words } = sorted(holds);
    const rows = notable.map((hold) => this.rowOf(hold));
    if (others.length) {
      const open = make("button", { type: "button", class: "plain", id: "holds-all", "aria-expanded": "false", onclick: () => this.holds.replaceChildren(...holds.map((hold) => this.rowOf(hold))) }, `${notable.length ? "and " : ""}${words}: show them`);
      rows.push(make("tr", {}, make("td", { colspan: 4 }, open)));
    }
    this.holds.replaceChildren(...rows);
  }

  /** A hold, which is a way to its place. */
  private rowOf(hold: Hold): HTMLElement {
    const to = make("button", { type: "button", class: "plain", title: "Go there", onclick: () => this.cockpit.document.seek(hold.from_s) }, fixed(hold.from_s, 2));
    const told = hold.verdict === "released" ? [] : warnings(hold);
    const kind = hold.verdict === "released" ? "" : kindOf(hold.verdict).replace("good", told.length ? "warn" : "");
    const swing = hold.peak_to_peak_n < 0.001 ? "0" : `${+hold.peak_to_peak_n.toPrecision(2)}`;
    return make("tr", { class: kind, title: [hold.reason, ...(hold.facts ?? []).map(({ text }) => text)].join("; ") }, make("td", {}, to), make("td", {}, `${+hold.hand_force_n.toPrecision(3)}`), make("td", {}, swing), make("td", {}, `${hold.verdict.replaceAll("_", " ")}${hold.frequency_hz ? `, ${+hold.frequency_hz.toPrecision(2)} Hz` : ""}${coupledText(hold)}${told.length ? `, ${told.join(", ")}` : ""}`));
  }
}
