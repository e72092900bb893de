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
}

const LABELS: Record<string, string> = {
  "hand.force": "hand F_m",
  "command.tip_force": "tip α_f F_s",
  "hand.position": "position",
  "hand.reference": "reference",
  "hand.motor_force": "motor",
  "hand.loop_age": "loop age",
  "tip.force": "normal",
  "tip.force_x": "lateral x",
  "tip.force_y": "lateral y",
  "link.forward_delay": "link →",
  "link.backward_delay": "link ←",
  "link.forward_loss": "loss →",
  "link.backward_loss": "loss ←",
  "law_master.port_energy": "master",
  "law_slave.port_energy": "slave",
  "law_master.net_energy": "net",
};

/** What a curve is called where its scope says the rest, and little room is left. */
export const SHORT: Record<string, string> = { "hand F_m": "hand", "tip α_f F_s": "tip", "lateral x": "x", "lateral y": "y", "loop age": "loop", "link →": "→", "link ←": "←", "loss →": "% →", "loss ←": "% ←" };

type Unit = readonly [unit: string, scale: number, floor: number];
const AT_TIP: Record<string, Unit> = { N: ["nN", 1e9, 0.5], m: ["nm", 1e9, 0.5] };
const ELSEWHERE: Record<string, Unit> = { N: ["N", 1, 0.05], m: ["mm", 1e3, 0.1], s: ["ms", 1e3, 1], J: ["mJ", 1e3, 0.01], W: ["mW", 1e3, 1] };

/** How a column of a stream is drawn. One unit for one quantity: N and mm at the hand, nN and nm at the tip, ms, mJ, %. */
export function drawnAs(store: Store, ref: CurveRef): Drawn {
  const about = store.streams.get(ref.stream)?.columns.find((column) => column.name === ref.column);
  const name = `${ref.stream}.${ref.column}`;
  const label = LABELS[name] ?? `${ref.stream.replace("_", " ")} ${ref.column.replaceAll("_", " ")}`;
  if (ref.column.endsWith("_loss")) return { label, unit: "%", scale: 100, floor: 2 };
  const si = about?.unit ?? "1";
  const [unit, scale, floor] = (ref.stream === "tip" ? AT_TIP[si] : undefined) ?? ELSEWHERE[si] ?? [si === "1" ? "" : si, 1, 1];
  return { label, unit, scale, floor };
}

/** Everything that can be drawn, by stream. */
export function catalog(store: Store): { stream: string; topic: string; curves: CurveRef[] }[] {
  return [...store.streams.values()].map(({ name, topic, columns }) => ({
    stream: name,
    topic,
    curves: columns.map((column) => ({ stream: name, column: column.name })),
  }));
}
