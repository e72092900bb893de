import { decode, encode } from "@msgpack/msgpack";

/** What this page was built for; the server refuses another version in words. */
export const PROTOCOL = 1;

export interface ColumnAbout {
  name: string;
  unit: string;
  about: string;
}

export interface StreamAbout {
  name: string;
  topic: string;
  columns: ColumnAbout[];
}

export interface StreamData {
  n: number;
  t0: number;
  data: Uint8Array;
}

export interface NodeFacts {
  state: string;
  uptime_s: number;
  rate_hz: number;
  overruns: number;
  cpu_percent: number;
  memory_bytes: number;
  replay: boolean;
  lateness_p99_s: number;
  lost: number;
  rejected: number;
  beat: number;
  /** The force above which the guard of the node withdraws the tip [N]; absent where it has no such guard. */
  force_limit_n?: number;
  /** Ends of the travel that the guard of the node allows the hand [m], towards the sample > 0; absent where it guards none. */
  travel_m?: [number, number];
}

export interface EventFacts {
  src: string;
  seq: number;
  t: number;
  kind: string;
  level: "info" | "warning" | "error";
  text: string;
  /** The law of which it is the warning of an adviser (`telenano.advisers`); absent for every other event. */
  advises?: string;
}

export interface WireArray {
  dtype: "u1" | "i2" | "i4" | "i8" | "f4" | "f8";
  shape: number[];
  data: Uint8Array;
}

export interface Line {
  line: number;
  lines: number;
  direction: "trace" | "retrace";
  start_m: [number, number, number];
  end_m: [number, number, number];
  height: WireArray;
}

export interface SourceAbout {
  kind: "live" | "recording";
  name: string;
  position_s?: number;
  length_s?: number;
  playing?: boolean;
  rate?: number;
}

export type Facts = Record<string, unknown>;

/** Who holds control: the number of the lease, the id and the name of its holder, whether it was taken, who asks. */
export interface LeaseFacts {
  number: number;
  holder: string;
  label: string;
  /** page, or what kind of process. */
  what: string;
  kept: boolean;
  asking: [id: string, label: string][];
  /** How the last holder lost control without wanting to: who it was, and a sentence; empty where it did not. */
  lost?: [] | [id: string, text: string];
}

export type Role = "operator" | "observer" | "participant";

export interface Changes {
  /** When the server sent this, on its clock [s]; a server whose rig is silent sends it all the same. */
  at_s?: number;
  /** Time of the publishers at which the times of the curves begin [ns], to a quarter of a microsecond. */
  origin_ns?: number;
  nodes?: Record<string, NodeFacts>;
  state?: Record<string, Facts>;
  events?: EventFacts[];
  lines?: Line[];
  streams?: Record<string, StreamData> | StreamAbout[];
  source?: SourceAbout;
  lease?: LeaseFacts;
  /** The age of the loop by its parts: name, of the median sample and of the slow one at 99 % [s]; the last is the whole. */
  age?: [name: string, p50_s: number, p99_s: number][];
}

export interface Tick extends Changes {
  k: "tick";
  streams?: Record<string, StreamData>;
}

/** A panel of a package that is installed where the server runs; `shows` is the state without which it is left out. */
export interface PanelAbout {
  id: string;
  title: string;
  region: string;
  shows: string;
  url: string;
}

export interface Snapshot extends Changes {
  k: "snapshot";
  role: Role;
  /** What this page is called in a lease. */
  me?: string;
  /** The letter of this window, where its person was given no name. */
  window?: string;
  commands: boolean;
  hand: boolean;
  streams: StreamAbout[];
  forms: Facts;
  source: SourceAbout;
  panels?: PanelAbout[];
  /** A sentence for each panel of a package that cannot be used. */
  problems?: string[];
}

export interface Answer {
  k: "answer";
  id: string;
  ok: boolean;
  /** Present where a node has not acknowledged and none has refused, such as one that is absent or out of reach. */
  refused?: false;
  text: string;
  /** What was asked for, where something was. */
  found?: unknown;
  /** The lease as it became, where it was asked for. */
  lease?: LeaseFacts;
}

export interface Refused {
  k: "refused";
  text: string;
}

export interface HandNotice {
  k: "hand";
  held: boolean;
  text: string;
  /** How late the hand of this page is [s], where it is too late to count; 0 where it is so no longer. */
  late_s?: number;
}

/** A question for the way to this page and back, and what it was found to be last [s]. */
export interface WayFrame {
  k: "way";
  stamp_s: number;
  way_s: number | null;
}

/** The newest force that is felt [N] in answer to a frame of the hand, with its age at the rig [s], and the stamp of that frame. */
export interface FeltFrame {
  k: "felt";
  force_n: number;
  age_s: number;
  number: number;
  stamp_s: number;
}

/** What serves the page has datagrams: the path of their session, and the hash of a certificate that nobody vouches for. */
export interface DatagramsFrame {
  k: "datagrams";
  path: string;
  hash: Uint8Array;
}

/** A datagram that comes back as it was sent. */
export interface ProbeFrame {
  k: "probe";
  stamp_s: number;
}

export interface Forms {
  k: "forms";
  forms: Facts;
}

export type ServerFrame = FeltFrame | DatagramsFrame | ProbeFrame | WayFrame | Forms | Tick | Snapshot | Answer | Refused | HandNotice;

export function read(frame: ArrayBuffer): ServerFrame {
  return decode(new Uint8Array(frame)) as ServerFrame;
}

export function pack(fields: Facts): Uint8Array<ArrayBuffer> {
  return encode(fields) as Uint8Array<ArrayBuffer>;
}

/** Numbers of a stream: little-endian float 32, wherever they lie in the frame. */
export function floats(data: Uint8Array): Float32Array {
  return new Float32Array(data.slice().buffer);
}

const READERS: Record<WireArray["dtype"], (bytes: ArrayBuffer) => ArrayLike<number>> = {
  u1: (bytes) => new Uint8Array(bytes),
  i2: (bytes) => new Int16Array(bytes),
  i4: (bytes) => new Int32Array(bytes),
  i8: (bytes) => Array.from(new BigInt64Array(bytes), Number),
  f4: (bytes) => new Float32Array(bytes),
  f8: (bytes) => new Float64Array(bytes),
};

/** Numbers of an array of the wire (SPEC.md, arrays of data). */
export function numbers(array: WireArray): ArrayLike<number> {
  return READERS[array.dtype](array.data.slice().buffer);
}
