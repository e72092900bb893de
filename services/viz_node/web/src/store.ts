import type { Oscillation } from "./oscillation";
import { Ring } from "./ring";
import {
  floats,
  type EventFacts,
  type Facts,
  type LeaseFacts,
  type Line,
  type NodeFacts,
  type Snapshot,
  type SourceAbout,
  type StreamAbout,
  type StreamData,
  type Tick,
} from "./protocol";

/** A minute of the loop at 1 kHz. */
const CAPACITY = 60_000;
const SLOW_CAPACITY = 12_000;
const EVENTS_KEPT = 200;
/** The source of what this page itself notes among the events of the nodes. */
const PAGE = "this page";

/** node/health comes twice a second: a node of which none came for this long is lost [ms]. */
export const LOST_MS = 900;
/** Visitors come and go. */
const VISITORS = /^(console|player|estop|view)/;
const LONGEST_STEP_MS = 100;

export interface Node extends NodeFacts {
  /** When its last report came, on the clock of the store [ms]. */
  heard: number;
}

/** Time in which the page could have heard something: a page that stood still does not take that for a silence. */
export class Clock {
  ms = 0;
  private at: number | undefined;

  tick(now: number): void {
    this.ms += Math.min(LONGEST_STEP_MS, Math.max(0, now - (this.at ?? now)));
    this.at = now;
  }
}

/** Everything that the page knows of the rig. */
export class Store {
  role: Snapshot["role"] = "observer";
  me = "";
  window = "";
  age: NonNullable<Tick["age"]> = [];
  /** The way from the server to this page and back [s], NaN until it is known. */
  wayS = NaN;
  /** Between two pictures that the server sends of the rig [s], NaN until it is known. */
  pictureS = NaN;
  /** Between two frames of this page, as requestAnimationFrame has them [s], NaN until it is known. */
  frameS = NaN;
  /** How the force that this page means and that of the hand are apart, in words; empty where they are not. */
  apart = "";
  lease: LeaseFacts = { number: 0, holder: "", label: "", what: "page", kept: false, asking: [] };
  commands = false;
  hand = false;
  forms: Facts = {};
  source: SourceAbout = { kind: "live", name: "" };
  originNs = 0;
  nodes = new Map<string, Node>();
  state = new Map<string, Facts>();
  events: EventFacts[] = [];
  rings = new Map<string, Ring>();
  streams = new Map<string, StreamAbout>();
  readonly clock = new Clock();
  onLines: (lines: Line[]) => void = () => {};
  onRestart: () => void = () => {};
  /** Value of a column at the playhead of a recording, NaN where it is not known. */
  recorded: (stream: string, column: string) => number = () => NaN;
  /** How the force swings at the playhead of a recording. */
  recordedSwing: () => Oscillation | undefined = () => undefined;
  private seen = new Set<string>();
  private noted = 0;

  /** Begin again with what the server knows. Curves stay, as after a lost connection, unless `forget`. */
  begin(snapshot: Snapshot): void {
    this.role = snapshot.role;
    this.me = snapshot.me ?? "";
    this.window = snapshot.window ?? "";
    if (snapshot.lease) this.lease = snapshot.lease;
    this.commands = snapshot.commands;
    this.hand = snapshot.hand;
    this.forms = snapshot.forms;
    this.source = snapshot.source;
    this.originNs = snapshot.origin_ns ?? 0;
    this.nodes.clear();
    this.state.clear();
    // what this page noted is in no snapshot, and it matters most after a lost connection
    const own = snapshot.source.kind === "live" ? this.events.filter(({ src }) => src === PAGE) : [];
    this.events = [];
    this.seen.clear();
    this.rings.clear();
    for (const stream of snapshot.streams) {
      this.streams.set(stream.name, stream);
      const isFast = stream.topic !== "law/status" && stream.topic !== "link/status";
      this.rings.set(stream.name, new Ring(stream.columns.length, isFast ? CAPACITY : SLOW_CAPACITY));
    }
    this.onRestart();
    const { nodes, state, events, lines } = snapshot;
    this.take({ k: "tick", ...(nodes && { nodes }), ...(state && { state }), ...(events && { events }), ...(lines && { lines }) });
    if (own.length) this.events = [...this.events, ...own].sort((one, other) => one.t - other.t);
  }

  take(tick: Tick): void {
    for (const [name, facts] of Object.entries(tick.nodes ?? {})) this.nodes.set(name, { ...facts, heard: this.clock.ms });
    for (const [name, facts] of Object.entries(tick.state ?? {})) this.state.set(name, facts);
    for (const event of tick.events ?? []) {
      const key = `${event.src} ${event.seq} ${event.t}`;
      if (this.seen.has(key)) continue;
      this.seen.add(key);
      this.events.push(event);
    }
    if (this.events.length > EVENTS_KEPT) this.events.splice(0, this.events.length - EVENTS_KEPT);
    for (const [name, data] of Object.entries(tick.streams ?? {})) this.push(name, data);
    if (tick.lines?.length) this.onLines(tick.lines);
    if (tick.source) this.source = tick.source;
    this.takeLease(tick.lease);
    if (tick.age) this.age = tick.age;
    if (tick.origin_ns) this.originNs = tick.origin_ns;
  }

  /** Note what became of an action of this page among the events; a recording has only its own. */
  note(level: EventFacts["level"], text: string): void {
    if (this.source.kind !== "live") return;
    this.take({ k: "tick", events: [{ src: PAGE, seq: this.noted++, t: Date.now() * 1e6, kind: "answer", level, text }] });
  }

  /** Take what the lease has become, and not what it was before: a tick may arrive after the answer that is newer. */
  takeLease(lease: LeaseFacts | undefined): void {
    if (lease && lease.number >= this.lease.number) this.lease = lease;
  }

  /** The number of the lease that this page has taken, 0 for none: one of a single act is over before the page knows of it. */
  get ownLease(): number {
    return this.lease.kept && this.me && this.lease.holder === this.me ? this.lease.number : 0;
  }

  /** Nodes that have stopped reporting; those of a recording come at the pace of the recording. */
  lost(): string[] {
    if (this.source.kind === "recording") return [];
    const isLost = ([name, node]: [string, Node]): boolean => !VISITORS.test(name) && node.state !== "ended" && this.clock.ms - node.heard > LOST_MS;
    return [...this.nodes].filter(isLost).map(([name]) => name);
  }

  /** The force above which the guard withdraws the tip [N]; NaN where no node has reported one. */
  get forceLimit_n(): number {
    for (const { force_limit_n } of this.nodes.values()) if (force_limit_n !== undefined) return force_limit_n;
    return NaN;
  }

  /** Newest time of all streams [s]. */
  get newest(): number {
    return Math.max(...[...this.rings.values()].map((ring) => ring.newest));
  }

  /** Newest value of a column, NaN without any. */
  last(stream: string, column: string): number {
    if (this.source.kind === "recording") {
      const value = this.recorded(stream, column);
      if (!Number.isNaN(value)) return value;
    }
    return this.rings.get(stream)?.last(this.column(stream, column)) ?? NaN;
  }

  column(stream: string, column: string): number {
    return this.streams.get(stream)?.columns.findIndex((about) => about.name === column) ?? -1;
  }

  fact(state: string, key: string): unknown {
    return this.state.get(state)?.[key];
  }

  private push(name: string, data: StreamData): void {
    this.rings.get(name)?.push(data.n, data.t0, floats(data.data));
  }
}
