import type { Felt } from "./socket.worker";
import { Freshness, OLD_S, SLOW_OLD_S } from "./freshness";
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

/** node/health comes twice a second: a node of which the server had none for this long is lost [s]. */
export const LOST_S = 0.9;
/** Visitors come and go, and a page that is heard has a server. */
const VISITORS = /^(console|player|estop|view|viz_node)/;
/** Streams of which there are a few samples a second. */
const SLOW_TOPICS = ["law/status", "link/status"];

export interface Node extends NodeFacts {
  /** When the server sent its last report, on the clock of the server [s]. */
  heard: number;
}

/** One instant of the rig: numbers, words, pictures and the step line of a frame are all made from it. */
interface Moment {
  /** Time of this page at which it was taken [ms]. */
  at: number;
  /** Newest values of each stream, by column, and the time of its newest sample [s]. */
  values: Map<string, number[]>;
  newest: Map<string, number>;
  facts: Map<string, Facts>;
}

/** Everything that the page knows of the rig. */
export class Store {
  role: Snapshot["role"] = "observer";
  me = "";
  window = "";
  age: NonNullable<Tick["age"]> = [];
  /** The way from the server to this page and back [s], NaN until it is known. */
  wayS = NaN;
  /** What is felt in answer to the hand of this page, and when it came [ms]; undefined before the first. */
  felt: (Felt & { at: number }) | undefined;
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
  readonly freshness = new Freshness();
  private moment: Moment | undefined;
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
      const isFast = !SLOW_TOPICS.includes(stream.topic);
      this.rings.set(stream.name, new Ring(stream.columns.length, isFast ? CAPACITY : SLOW_CAPACITY));
    }
    this.moment = undefined;
    this.freshness.begin();
    this.onRestart();
    const { nodes, state, events, lines, at_s } = snapshot;
    this.take({ k: "tick", ...(at_s !== undefined && { at_s }), ...(nodes && { nodes }), ...(state && { state }), ...(events && { events }), ...(lines && { lines }) });
    if (own.length) this.events = [...this.events, ...own].sort((one, other) => one.t - other.t);
  }

  /** Take in what the server sent, at a time of this page [ms]. */
  take(tick: Tick, now = performance.now()): void {
    for (const [name, data] of Object.entries(tick.streams ?? {})) this.push(name, data);
    if (tick.at_s !== undefined) this.freshness.take(tick.at_s, now, this.newest);
    const heard = this.freshness.sentAt;
    for (const [name, facts] of Object.entries(tick.nodes ?? {})) this.nodes.set(name, { ...facts, heard });
    for (const [name, facts] of Object.entries(tick.state ?? {})) this.state.set(name, facts);
    for (const event of tick.events ?? []) {
      const key = `${event.src} ${event.seq} ${event.t}`;
      if (this.seen.has(key)) continue;
      this.seen.add(key);
      this.events.push(event);
    }
    // of several nodes they come in no order
    if (tick.events?.length) this.events.sort((one, other) => one.t - other.t);
    if (this.events.length > EVENTS_KEPT) this.events.splice(0, this.events.length - EVENTS_KEPT);
    if (tick.lines?.length) this.onLines(tick.lines);
    if (tick.source) this.source = tick.source;
    this.takeLease(tick.lease);
    if (tick.age) this.age = tick.age;
    if (tick.origin_ns) this.originNs = tick.origin_ns;
  }

  /** Note what became of an action of this page among the events; a recording has only its own. */
  note(level: EventFacts["level"], text: string): void {
    if (this.source.kind !== "live") return;
    // by the clock of the rig, as those of the nodes
    const now_s = this.freshness.newest(performance.now());
    const t = this.originNs && Number.isFinite(now_s) ? this.originNs + 1e9 * now_s : Date.now() * 1e6;
    this.take({ k: "tick", events: [{ src: PAGE, seq: this.noted++, t, kind: "answer", level, text }] });
  }

  /** Take what the lease has become, and not what it was before: a tick may arrive after the answer that is newer. */
  takeLease(lease: LeaseFacts | undefined): void {
    if (lease && lease.number >= this.lease.number) this.lease = lease;
  }

  /** The number of the lease that this page has taken, 0 for none: one of a single act is over before the page knows of it. */
  get ownLease(): number {
    return this.lease.kept && this.me && this.lease.holder === this.me ? this.lease.number : 0;
  }

  /**
   * Nodes that have stopped reporting to the server, as far as this page knows: a page that hears nothing knows nothing
   * of the nodes. Those of a recording come at the pace of the recording.
   */
  lost(): string[] {
    if (this.source.kind === "recording") return [];
    const isLost = ([name, node]: [string, Node]): boolean => !VISITORS.test(name) && node.state !== "ended" && this.freshness.sentAt - node.heard > LOST_S;
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

  /** Take the instant that this frame shows [ms]. What is read afterwards is of this instant, until there is another one. */
  look(now: number, wall = Date.now()): void {
    this.freshness.look(now, wall);
    const values = new Map([...this.rings].map(([name, ring]) => [name, Array.from({ length: ring.columns }, (_, column) => ring.last(column))]));
    const newest = new Map([...this.rings].map(([name, ring]) => [name, ring.newest]));
    this.moment = { at: now, values, newest, facts: new Map(this.state) };
  }

  /** The time of the instant that is shown [ms]. */
  get at(): number {
    return this.moment?.at ?? performance.now();
  }

  /** How long ago the server sent what is shown [s]; 0 for a recording, which has no present. */
  get pictureAge(): number {
    return this.source.kind === "recording" ? 0 : this.freshness.picture(this.at);
  }

  /** Whether this page has heard nothing for so long that it must not show what it knows as present. */
  get isPictureOld(): boolean {
    return this.pictureAge > OLD_S;
  }

  /** The age of the newest sample of a stream [s]: NaN where there is none, 0 in a recording. */
  age_s(stream: string): number {
    if (this.source.kind === "recording") return 0;
    return this.freshness.sample(this.moment?.newest.get(stream) ?? this.rings.get(stream)?.newest ?? -Infinity, this.at);
  }

  /** Whether what is shown of a stream is not of the present. */
  isOld(stream: string): boolean {
    return this.age_s(stream) > (SLOW_TOPICS.includes(this.streams.get(stream)?.topic ?? "") ? SLOW_OLD_S : OLD_S);
  }

  /** Value of a column in the instant that is shown, NaN without any. */
  last(stream: string, column: string): number {
    if (this.source.kind === "recording") {
      const value = this.recorded(stream, column);
      if (!Number.isNaN(value)) return value;
    }
    const at = this.column(stream, column);
    if (at < 0) return NaN;
    return this.moment?.values.get(stream)?.[at] ?? this.rings.get(stream)?.last(at) ?? NaN;
  }

  column(stream: string, column: string): number {
    return this.streams.get(stream)?.columns.findIndex((about) => about.name === column) ?? -1;
  }

  fact(state: string, key: string): unknown {
    return this.facts(state)?.[key];
  }

  /** All that is known of a state in the instant that is shown. */
  facts(state: string): Facts | undefined {
    return (this.moment?.facts ?? this.state).get(state);
  }

  /** Ends of the travel of the hand, the one away from the sample first [m]; undefined where no node has reported them. */
  get travel_m(): readonly [number, number] | undefined {
    for (const { travel_m } of this.nodes.values()) if (travel_m) return travel_m;
    return undefined;
  }

  private push(name: string, data: StreamData): void {
    this.rings.get(name)?.push(data.n, data.t0, floats(data.data));
  }
}
