import type { LinkState } from "./connection";
import { whyWithdrawn } from "./guard";
import { ageWords } from "./freshness";
import { oscillationIn } from "./oscillation";
import { programName } from "./programs";
import { speaker } from "./sentences";
import type { Store } from "./store";
import { fixed } from "./numbers";

export type Kind = "good" | "warn" | "bad";
export type Banner = [kind: Kind, text: string];

const WATCHED_S = 15;
/** At the hand: below this a swing of the force is not felt [N]. */
const FELT_N = 0.3;
const SAMPLES = 1500;

/** The state of the rig or of the page in words, what an operator must not overlook first. */
export function bannersOf(store: Store, link: LinkState, linkText: string): Banner[] {
  if (link !== "open") return [["bad", `DISCONNECTED: ${linkText}`]];
  // a page that hears nothing knows nothing of the rig, and blames no node of it
  if (store.isPictureOld) return [["bad", `NOT CONNECTED: ${oldWords(store)}`]];
  const nodes = [...store.nodes.values()];
  const isLive = store.source.kind === "live";
  if (!nodes.length) return [["warn", isLive ? "NO RIG: no node has reported yet" : "REPLAY: no instrument is connected"]];
  if (isLive && nodes.every((node) => node.state === "ended" || node.state === "stopping")) return [["bad", "THE RIG HAS ENDED"]];
  const found: Banner[] = [];
  const [hand, tip] = [store.fact("haptic/state/master", "estop") === true, store.fact("afm/state/slave", "mode") === "estop"];
  if (hand || tip) found.push(["bad", `EMERGENCY STOP${hand && tip ? "" : hand ? " OF THE HAND" : " OF THE TIP"}: arm to continue`]);
  // what was stopped swings no more, whatever the last seconds show
  const swing = found.length ? undefined : isLive ? swingOf(store) : store.recordedSwing();
  const lost = store.lost();
  if (lost.length) found.push(["bad", `LOST: ${lost.map((name) => speakerOf(name, store)).join(", ")}`]);
  if (store.apart) found.push(["bad", `FORCE DIFFERS: ${store.apart}`]);
  if (swing) found.push(["bad", `OSCILLATES: ${fixed(swing.peakToPeak, 1)} N peak to peak at ${fixed(swing.hertz, 1)} Hz`]);
  if (!isLive || nodes.some((node) => node.replay)) found.push(["warn", "REPLAY: no instrument is connected"]);
  const delay = roundTripOf(store);
  if (delay > 1e-3) found.push(["warn", `DELAYED: ${fixed(delay * 1e3, 1)} ms round trip`]);
  if (store.fact("law/status/master", "passive") === false) found.push(["warn", "NOT PASSIVE: the loop has made energy"]);
  const away = isLive && !tip && !programOf(store) ? awayOf(store) : "";
  if (away) found.push(["warn", away]);
  if (!found.length) found.push(["good", "running"]);
  const doing = isLive && !away ? doingOf(store) : "";
  // an instrument that runs a program runs it whatever else is to be seen
  if (doing && (found[0]![0] !== "bad" || programOf(store))) found.push([found[0]![0], doing]);
  return found;
}

/** Whether nothing comes; what is old although something comes has waited on its way, or for this page. */
export function isSilent(store: Store): boolean {
  return store.freshness.silence(store.at) > store.pictureAge / 2;
}

/** That what this page shows is not of the present, and by how much. */
export function oldWords(store: Store): string {
  const age = store.pictureAge;
  return isSilent(store) ? `this page has heard nothing for ${ageWords(age)}` : `what this page shows is ${ageWords(age)} old`;
}

/** Of which part nothing new has come, and for how long; empty where all that moves is of the present. */
export function oldPart(store: Store): string {
  const [part, stream] = store.isOld("hand") ? ["hand", "hand"] : store.isOld("tip") ? ["tip", "tip"] : ["", ""];
  return part && `Nothing has come from the ${part} for ${ageWords(store.age_s(stream!))}`;
}

/** What a node is called, with its place where there is one of the kind at either. */
function speakerOf(name: string, store: Store): string {
  const [kind, site] = name.split("@");
  const isTwin = [...store.nodes.keys()].some((other) => other !== name && other.startsWith(`${kind}@`));
  return `${speaker(name)}${isTwin ? (site === "slave" ? " at the tip" : " at the hand") : ""}`;
}

/** What the link delays there and back [s]. */
export function roundTripOf(store: Store): number {
  const delays = ["forward", "backward"].map((way) => {
    const facts = store.fact("link", way) as { delay_valid?: boolean; delay_mean_s?: number } | undefined;
    return facts?.delay_valid ? (facts.delay_mean_s ?? 0) : 0;
  });
  return delays[0]! + delays[1]!;
}

interface ProgramFacts {
  program: string;
  state: string;
  done_percent: number;
}

/** The program that the instrument runs, or that it pauses. */
function programOf(store: Store): ProgramFacts | undefined {
  const program = store.facts("afm/program/slave") as ProgramFacts | undefined;
  return program && ["running", "paused"].includes(program.state) ? program : undefined;
}

/** Why the tip does not follow the hand although no program runs and nothing is stopped; empty where it does. */
function awayOf(store: Store): string {
  const mode = String(store.fact("afm/state/slave", "mode") ?? "");
  if (mode === "hold") return "THE TIP HOLDS ITS PLACE: no fresh command comes";
  if (!mode.startsWith("retract")) return "";
  if (mode === "retracted" && store.fact("afm/state/slave", "armed") === true) return "the tip is armed, and waits until the hand is armed";
  const why = whyWithdrawn(store.events);
  return `THE TIP ${mode === "retracted" ? "IS WITHDRAWN" : "MOVES AWAY"}${why && `: ${why}`}`;
}

/** What the instrument does, in words. */
function doingOf(store: Store): string {
  const program = programOf(store);
  if (program) {
    return `${programName(program.program)} ${program.state === "paused" ? "paused" : "runs"}, ${fixed(program.done_percent, 0)} %`;
  }
  const mode = String(store.fact("afm/state/slave", "mode") ?? "");
  if (mode === "follow" && store.fact("afm/state/slave", "placed") === false) return "the tip is on its way to the hand";
  return mode === "follow" ? "the tip follows the hand" : "";
}

/** What was found of the samples up to a time [s]: several panels ask for it. */
const swings = new WeakMap<Store, { until: number; found: ReturnType<typeof oscillationIn> }>();

/** How the force of the tip at the hand's scale has been swinging for the last seconds; undefined where it has not. */
export function swingOf(store: Store): ReturnType<typeof oscillationIn> {
  const ring = store.rings.get("command");
  const column = store.column("command", "tip_force");
  if (!ring?.length || column < 0) return undefined;
  const known = swings.get(store);
  if (known && known.until === ring.newest) return known.found;
  const first = ring.indexAt(ring.newest - WATCHED_S);
  const step = Math.max(1, Math.floor((ring.length - first) / SAMPLES));
  const [times, values]: [number[], number[]] = [[], []];
  for (let i = first; i < ring.length; i += step) {
    const value = ring.value(column, i);
    if (Number.isNaN(value)) continue;
    times.push(ring.time(i));
    values.push(value);
  }
  const found = oscillationIn(times, values, FELT_N);
  swings.set(store, { until: ring.newest, found });
  return found;
}
