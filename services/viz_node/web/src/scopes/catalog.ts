import type { Store } from "../store";

/** A column of a stream, as a scope names it. */
export interface CurveRef {
  stream: string;
  column: string;
}

/** How a column is drawn: its name, its unit, what its SI value is multiplied by, and what is still noise in that unit. */
export interface Drawn {
  label: string;
  unit: string;
  scale: number;
  floor: number;
  /** The token of its colour, by what it means, and whether it is dashed: what is asked for, and what was lost. */
  colour: string;
  isDashed: boolean;
}

const LABELS: Record<string, string> = {
  "hand.force": "hand",
  "command.tip_force": "tip",
  "hand.position": "position",
  "hand.reference": "reference",
  "hand.motor_force": "motor",
  "hand.loop_age": "whole loop",
  "tip.force": "normal",
  "tip.force_x": "lateral x",
  "tip.force_y": "lateral y",
  "link.forward_delay": "link there",
  "link.backward_delay": "link back",
  "link.forward_loss": "lost there",
  "link.backward_loss": "lost back",
  "law_master.port_energy": "at the hand",
  "law_slave.port_energy": "at the tip",
  "law_master.net_energy": "both",
};

/** What a curve is called where its scope says the rest, and little room is left. */
export const SHORT: Record<string, string> = { "lateral x": "x", "lateral y": "y", "whole loop": "loop", "link there": "there", "link back": "back", "lost there": "there", "lost back": "back", position: "hand", reference: "asked", "at the hand": "hand", "at the tip": "tip" };

/** What a colour of a curve is where it is not that of its stream: the way there is of the hand, the way back of the tip. */
const COLOURS: Record<string, readonly [token: string, isDashed: boolean]> = {
  "hand.reference": ["hand", true],
  "hand.motor_force": ["tip", true],
  "hand.loop_age": ["text", false],
  "hand.x": ["lateral", false],
  "hand.y": ["lateral", true],
  "command.force_x": ["lateral", false],
  "command.force_y": ["lateral", true],
  "tip.force_x": ["lateral", false],
  "tip.force_y": ["lateral", true],
  "tip.x": ["lateral", false],
  "tip.y": ["lateral", true],
  "tip.base": ["tip", true],
  "link.forward_delay": ["hand", false],
  "link.backward_delay": ["tip", false],
  "link.forward_loss": ["hand", true],
  "link.backward_loss": ["tip", true],
  "law_master.net_energy": ["text", false],
  "law_slave.net_energy": ["text", true],
};
const OF_STREAM: Record<string, string> = { hand: "hand", law_master: "hand", command: "tip", tip: "tip", law_slave: "tip" };
/** What curves are drawn in of which another one of their scope looks alike already. */
const FURTHER: readonly (readonly [token: string, isDashed: boolean])[] = [["extra", false], ["extra", true], ["quiet", false], ["quiet", true], ["text", true]];

type Unit = readonly [unit: string, scale: number, floor: number];
const AT_TIP: Record<string, Unit> = { N: ["nN", 1e9, 0.5], m: ["nm", 1e9, 0.5] };
const ELSEWHERE: Record<string, Unit> = { N: ["N", 1, 0.05], m: ["mm", 1e3, 0.1], s: ["ms", 1e3, 1], J: ["mJ", 1e3, 0.01], W: ["mW", 1e3, 1] };

/** How a column of a stream is drawn. One unit for one quantity: N and mm at the hand, nN and nm at the tip, ms, mJ, %. */
export function drawnAs(store: Store, ref: CurveRef): Drawn {
  const about = store.streams.get(ref.stream)?.columns.find((column) => column.name === ref.column);
  const name = `${ref.stream}.${ref.column}`;
  const label = LABELS[name] ?? `${ref.stream.replace("_", " ")} ${ref.column.replaceAll("_", " ")}`;
  const [colour, isDashed] = COLOURS[name] ?? [OF_STREAM[ref.stream] ?? "extra", false];
  if (ref.column.endsWith("_loss")) return { label, unit: "%", scale: 100, floor: 2, colour, isDashed };
  const si = about?.unit ?? "1";
  const [unit, scale, floor] = (ref.stream === "tip" ? AT_TIP[si] : undefined) ?? ELSEWHERE[si] ?? [si === "1" ? "" : si, 1, 1];
  return { label, unit, scale, floor, colour, isDashed };
}

/** How the curves of one scope are drawn: no two of them look alike, as far as there are colours. */
export function drawnTogether(store: Store, refs: readonly CurveRef[]): Drawn[] {
  const taken = new Set<string>();
  return refs.map((ref) => {
    const drawn = drawnAs(store, ref);
    const looks = [[drawn.colour, drawn.isDashed] as const, ...FURTHER];
    const [colour, isDashed] = looks.find(([name, dashed]) => !taken.has(`${name} ${dashed}`)) ?? looks[0]!;
    taken.add(`${colour} ${isDashed}`);
    return { ...drawn, colour, isDashed };
  });
}

/** Everything that can be drawn, by stream. */
export function catalog(store: Store): { stream: string; topic: string; curves: CurveRef[] }[] {
  return [...store.streams.values()].map(({ name, topic, columns }) => ({
    stream: name,
    topic,
    curves: columns.map((column) => ({ stream: name, column: column.name })),
  }));
}
