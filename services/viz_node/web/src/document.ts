import type { Connection } from "./connection";
import type { Oscillation } from "./oscillation";
import { floats, type StreamData } from "./protocol";
import { Ring } from "./ring";
import type { Store } from "./store";
import { fixed } from "./numbers";

export interface Span {
  kind: string;
  from_s: number;
  to_s: number;
}
export interface Hold {
  from_s: number;
  to_s: number;
  hand_force_n: number;
  verdict: string;
  reason: string;
  /** What else is true of it, such as that the tip was struck. */
  facts?: readonly { kind: string; value: number; text: string }[];
  growth_per_s: number | null;
  peak_to_peak_n: number;
  /** Of a swing that stands in the place of a hold, where a person is the hand [Hz]. */
  frequency_hz?: number | null;
  /** Share of the hold in which hand and tip were coupled, 0 to 1. */
  coupled_share?: number;
}
/** A time in which the loop was open, or a process was away. */
export interface Interruption extends Omit<Span, "kind"> {
  kind: string;
  reason: string;
}
export interface Swing {
  from_s: number;
  to_s: number;
  hertz: number;
  peak_to_peak_n: number;
}
export interface Moment {
  t_s: number;
  kind: string;
  level: string;
  src: string;
  text: string;
}
export interface About {
  length_s: number;
  start_ns: number;
  read: number;
  session_s?: [number, number];
  phases?: Span[];
  holds?: Hold[];
  swings?: Swing[];
  interruptions?: Interruption[];
  /** From when to when messages are missing from the recording. */
  losses?: Omit<Span, "kind">[];
  moments?: Moment[];
  summary?: Record<string, unknown> | null;
  fault?: string;
}

/** That there is no event on a side of the playhead, as far as the server has read the file. */
export function noMoment(forwards: boolean, read: number): string {
  const how = read >= 1 ? "" : read >= ALL_READ ? " (all is read, the events are being looked for)" : ` (read so far: ${Math.floor(100 * read)} %)`;
  return `No ${forwards ? "later" : "earlier"} event${how}`;
}

/** Holds in which the hand does not press hold nothing, whatever stands still in them: they are named `released`. */
export function withoutReleased(holds: readonly Hold[]): Hold[] {
  const greatest = Math.max(0, ...holds.map(({ hand_force_n }) => Math.abs(hand_force_n)));
  return holds.map((hold) => (hold.verdict === "stable" && Math.abs(hold.hand_force_n) <= PRESSING_SHARE * greatest ? { ...hold, verdict: "released" } : hold));
}

/** Curves of a part of a recording: samples by stream, and the width of their spans [s], 0 where it is every sample. */
export interface Part {
  from: number;
  to: number;
  width: number;
  rings: Map<string, Ring>;
}

interface PartAnswer {
  from_s: number;
  to_s: number;
  width_s: number;
  streams: Record<string, StreamData>;
}

const WHOLE_SPANS = 1500;
const PART_SPANS = 3600;
/** How often is asked again while the server still reads the file. */
const READING_MS = 600;
/** The server says this while it judges what it has read. */
const ALL_READ = 0.999;
/** A hand that presses with no more than this share of its greatest force has let go, as in the verdicts of a report. */
const PRESSING_SHARE = 0.05;
const SEEK_MS = 80;
/** A part reaches beyond what is seen by this much of it on both sides, so that a playhead that moves finds it there. */
const MARGIN = 0.75;

/** A recording that is read in: where one is in it, its curves around there, and what happened in the whole of it. */
export class Document {
  about: About | undefined;
  whole: Part | undefined;
  /** The stretch that is chosen for a file, its ends [s]. */
  chosen: [number | undefined, number | undefined] = [undefined, undefined];
  isLooped = false;
  /** Counts what came, so that who draws knows when to draw again. */
  version = 0;
  onChange: () => void = () => {};
  private part: Part | undefined;
  private asked = "";
  private readings = 0;
  private place = 0;
  private anchoredAt = 0;
  private told: unknown;
  private seekTimer: ReturnType<typeof setTimeout> | undefined;
  private scrubUntil = 0;

  constructor(
    private readonly connection: Connection,
    private readonly store: Store,
  ) {}

  get isThere(): boolean {
    return this.store.source.kind === "recording";
  }

  get length(): number {
    return this.store.source.length_s ?? 0;
  }

  /** How far the server has read the file, in words; empty when it knows everything. */
  get progress(): string {
    const { about } = this;
    if (!about) return "the recording is being opened";
    if (about.read >= 1) return "";
    return about.read >= ALL_READ ? "all curves are read, phases and verdicts follow" : `read so far: ${Math.floor(100 * about.read)} %, beginning with what is looked at`;
  }

  begin(): void {
    this.about = this.whole = this.part = undefined;
    this.asked = "";
    if (this.isThere) void this.read();
  }

  /** Where the playhead is now [s]. Between two words of the server it goes on at the rate that was told. */
  at(now: number): number {
    const { source } = this.store;
    if (source !== this.told && now > this.scrubUntil) {
      this.told = source;
      const told = source.position_s ?? 0;
      // a place that is told to a tenth of a second does not move a playhead that is as near as that
      const expected = this.place + ((now - this.anchoredAt) / 1e3) * (source.rate ?? 1);
      this.place = source.playing && Math.abs(expected - told) < 0.15 * Math.max(1, source.rate ?? 1) ? expected : told;
      this.anchoredAt = now;
    }
    if (!source.playing || now < this.scrubUntil) return this.place;
    return Math.min(this.length, this.place + ((now - this.anchoredAt) / 1e3) * (source.rate ?? 1));
  }

  /** Go to a place [s]: here at once, and at the server when the hand rests for a moment. */
  seek(place: number): void {
    const now = performance.now();
    this.place = Math.min(this.length, Math.max(0, place));
    this.anchoredAt = now;
    this.scrubUntil = now + 600;
    clearTimeout(this.seekTimer);
    this.seekTimer = setTimeout(() => void this.transport("seek", this.place), SEEK_MS);
    this.onChange();
  }

  async transport(action: string, value = 0): Promise<{ ok: boolean; text: string }> {
    if (action !== "seek") this.scrubUntil = 0;
    return this.connection.ask({ k: "transport", action, value });
  }

  /** The curves to draw from one time to another [s]: the finest that are here, while finer ones are asked for. */
  between(from: number, to: number): Part | undefined {
    const covers = this.part && this.part.from <= Math.max(0, from) + 1e-6 && this.part.to >= Math.min(this.length, to) - 1e-6;
    const fits = covers && (this.part!.width === 0 || this.part!.to - this.part!.from <= 6 * (to - from));
    const isMissed = covers && this.part!.to - this.part!.from > 6 * (to - from);
    if (!covers || isMissed) void this.ask(from, to);
    if (fits || covers) return this.part;
    return this.whole ?? this.part;
  }

  /** Every sample of a part [s]; undefined and words where the server gives none. */
  async samples(from: number, to: number): Promise<Part | string> {
    const answer = await this.connection.ask({ k: "part", from_s: from, to_s: to, spans: 0 });
    return answer.ok ? this.taken(answer.found as PartAnswer) : answer.text;
  }

  /** Value of a column at the playhead; NaN where nothing is known. */
  value(stream: string, column: string, now: number): number {
    const ring = (this.part ?? this.whole)?.rings.get(stream) ?? this.whole?.rings.get(stream);
    const index = this.store.column(stream, column);
    if (!ring?.length || index < 0) return NaN;
    const at = this.at(now);
    for (let i = Math.min(ring.length - 1, ring.indexAt(at + 1e-4)); i >= 0 && ring.time(i) > at - 0.5; i--) {
      const value = ring.value(index, i);
      if (ring.time(i) <= at + 0.02 && !Number.isNaN(value)) return value;
    }
    return NaN;
  }

  /** The hold, or the swing in the place of one, at a place [s]; of two that overlap the later one. */
  holdAt(place: number): Hold | undefined {
    return this.about?.holds?.findLast(({ from_s, to_s }) => from_s <= place && place < to_s);
  }

  /** How the force that the hand is shown swings at a place [s]. */
  swingAt(place: number): Oscillation | undefined {
    const found = this.about?.swings?.find(({ from_s, to_s }) => from_s <= place && place <= to_s);
    return found && { hertz: found.hertz, peakToPeak: found.peak_to_peak_n };
  }

  /** The next moment after a place, or the one before it [s]. */
  moment(from: number, forwards: boolean): Moment | undefined {
    const moments = this.about?.moments ?? [];
    return forwards ? moments.find((moment) => moment.t_s > from + 1e-3) : moments.findLast((moment) => moment.t_s < from - 1e-3);
  }

  /** The next sample of a stream after a place [s]; a millisecond on where the samples there are not here. */
  sampleAfter(stream: string, place: number): number {
    const ring = this.part?.width === 0 ? this.part.rings.get(stream) : undefined;
    const next = ring ? ring.indexAt(place + 1e-5) : 0;
    return ring && next < ring.length ? ring.time(next) : place + 1e-3;
  }

  private async read(): Promise<void> {
    const reading = ++this.readings;
    for (;; await new Promise((go) => setTimeout(go, READING_MS))) {
      const answer = await this.connection.ask({ k: "document" });
      if (reading !== this.readings) return;
      // a server that is busy answers late, or refuses one question of many
      if (!answer.ok) continue;
      const about = answer.found as About;
      const { length_s } = about;
      this.about = about.holds ? { ...about, holds: withoutReleased(about.holds) } : about;
      this.changed();
      const part = await this.connection.ask({ k: "part", from_s: 0, to_s: Math.max(length_s, 1e-3), spans: WHOLE_SPANS });
      if (reading !== this.readings) return;
      if (part.ok) this.whole = this.taken(part.found as PartAnswer);
      this.part = undefined;
      this.asked = "";
      this.changed();
      if (about.read >= 1 && part.ok) return;
    }
  }

  private async ask(from: number, to: number): Promise<void> {
    const margin = MARGIN * (to - from);
    const [begin, end] = [Math.max(0, from - margin), Math.min(this.length, to + margin)];
    const key = `${fixed(begin, 3)} ${fixed(end, 3)}`;
    if (this.asked || !(end > begin)) return;
    this.asked = key;
    const answer = await this.connection.ask({ k: "part", from_s: begin, to_s: end, spans: PART_SPANS });
    if (this.asked === key) this.asked = "";
    if (!answer.ok) return;
    this.part = this.taken(answer.found as PartAnswer);
    this.changed();
  }

  private taken(answer: PartAnswer): Part {
    const rings = new Map<string, Ring>();
    for (const [name, data] of Object.entries(answer.streams)) {
      const columns = this.store.streams.get(name)?.columns.length ?? 0;
      const ring = new Ring(columns, Math.max(1, data.n));
      if (data.n) ring.push(data.n, data.t0, floats(data.data));
      rings.set(name, ring);
    }
    return { from: answer.from_s, to: answer.to_s, width: answer.width_s, rings };
  }

  private changed(): void {
    this.version++;
    this.onChange();
  }
}
