import { Ring } from "./ring";
import {
  floats,
  type EventFacts,
  type Facts,
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

export interface Node extends NodeFacts {
  /** When its last report came, on the clock of the page [ms]. */
  heard: number;
}

/** Everything that the page knows of the rig. */
export class Store {
  role: "operator" | "observer" = "observer";
  commands = false;
  hand = false;
  forms: Facts = {};
  source: SourceAbout = { kind: "live", name: "" };
  nodes = new Map<string, Node>();
  state = new Map<string, Facts>();
  events: EventFacts[] = [];
  rings = new Map<string, Ring>();
  streams = new Map<string, StreamAbout>();
  onLines: (lines: Line[]) => void = () => {};
  onRestart: () => void = () => {};
  private seen = new Set<string>();

  /** Begin anew with what the server knows. Curves stay, as after a lost connection, unless `forget`. */
  begin(snapshot: Snapshot): void {
    this.role = snapshot.role;
    this.commands = snapshot.commands;
    this.hand = snapshot.hand;
    this.forms = snapshot.forms;
    this.source = snapshot.source;
    this.nodes.clear();
    this.state.clear();
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
  }

  take(tick: Tick): void {
    const now = performance.now();
    for (const [name, facts] of Object.entries(tick.nodes ?? {})) this.nodes.set(name, { ...facts, heard: now });
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
  }

  /** Newest time of all streams [s]. */
  get newest(): number {
    return Math.max(...[...this.rings.values()].map((ring) => ring.newest));
  }

  /** Newest value of a column, NaN without any. */
  last(stream: string, column: string): number {
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
