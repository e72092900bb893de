import type { CurveRef } from "./catalog";

export type ScopeKind = "time" | "spectrum" | "distance";

/** What one scope draws, and in which range of its left axis; automatic where there is none. */
export interface ScopeSpec {
  title: string;
  kind: ScopeKind;
  curves: CurveRef[];
  range: [number, number] | null;
}

const curves = (...names: string[]): CurveRef[] => names.map((name) => ({ stream: name.split(".")[0]!, column: name.split(".")[1]! }));
const scope = (title: string, ...names: string[]): ScopeSpec => ({ title, kind: "time", curves: curves(...names), range: null });

const FORCE = scope("Hand force", "hand.force", "command.tip_force");
const HAND = scope("Hand way", "hand.position", "hand.reference");
const TIP = scope("Tip force", "tip.force", "tip.force_x", "tip.force_y");
const DISTANCE: ScopeSpec = { title: "Force curve", kind: "distance", curves: curves("tip.force", "tip.separation"), range: null };
const DELAY = scope("Delay", "hand.loop_age", "link.forward_delay", "link.backward_delay");
const LOSS = scope("Lost", "link.forward_loss", "link.backward_loss");
const ENERGY = scope("Energy", "law_master.port_energy", "law_slave.port_energy", "law_master.net_energy");

/** Layouts that every page has. */
export const BUILT_IN: Record<string, ScopeSpec[]> = {
  Loop: [FORCE, HAND, TIP, DISTANCE, DELAY, ENERGY],
  Touch: [FORCE, HAND, DISTANCE],
  Tip: [TIP, scope("Tip to sample", "tip.separation"), scope("Deflection", "tip.deflection"), DISTANCE],
  Stability: [FORCE, { ...FORCE, title: "Spectrum", kind: "spectrum" }, ENERGY, DELAY, LOSS],
};

const KEY = "telenano-layouts";
const NOW = "telenano-layout";

type Kept = Pick<Storage, "getItem" | "setItem">;

/** Layouts of scopes: those of every page, and those that a person has saved in this browser. */
export class Layouts {
  private saved: Record<string, ScopeSpec[]> = {};

  constructor(private readonly storage: () => Kept) {
    this.saved = parsed(this.read(KEY)) ?? {};
  }

  get names(): string[] {
    return [...Object.keys(BUILT_IN), ...Object.keys(this.saved).filter((name) => !(name in BUILT_IN))];
  }

  /** The scopes of a layout, to be changed at will; the first of all where there is none of the name. */
  get(name: string): ScopeSpec[] {
    return structuredClone(this.saved[name] ?? BUILT_IN[name] ?? BUILT_IN["Loop"]!);
  }

  isOwn(name: string): boolean {
    return name in this.saved;
  }

  save(name: string, specs: ScopeSpec[]): void {
    this.saved[name] = structuredClone(specs);
    this.write(KEY, JSON.stringify(this.saved));
  }

  remove(name: string): void {
    delete this.saved[name];
    this.write(KEY, JSON.stringify(this.saved));
  }

  /** The layout that was shown last in this browser, as it was then. */
  get now(): { name: string; specs: ScopeSpec[] } {
    const found = parsed(this.read(NOW)) as unknown as { name: string; specs: ScopeSpec[] } | undefined;
    return found?.specs?.length ? found : { name: "Loop", specs: this.get("Loop") };
  }

  keep(name: string, specs: ScopeSpec[]): void {
    this.write(NOW, JSON.stringify({ name, specs }));
  }

  private read(key: string): string | null {
    try {
      return this.storage().getItem(key);
    } catch {
      return null;
    }
  }

  private write(key: string, text: string): void {
    try {
      this.storage().setItem(key, text);
    } catch {
      // a browser that keeps nothing shows the usual layout the next time
    }
  }
}

/** Move a scope to before another; the list that is returned is a new one. */
export function moved<T>(list: readonly T[], from: number, to: number): T[] {
  const rest = list.filter((_, i) => i !== from);
  rest.splice(from < to ? to - 1 : to, 0, list[from]!);
  return rest;
}

/** Draw the curves of one scope in another as well, and remove the first. */
export function overlaid(specs: readonly ScopeSpec[], from: number, onto: number): ScopeSpec[] {
  const [one, other] = [specs[from]!, specs[onto]!];
  const known = new Set(other.curves.map((curve) => `${curve.stream}.${curve.column}`));
  const both = { ...other, title: `${other.title}, ${one.title.toLowerCase()}`, curves: [...other.curves, ...one.curves.filter((curve) => !known.has(`${curve.stream}.${curve.column}`))] };
  return specs.map((spec, i) => (i === onto ? both : spec)).filter((_, i) => i !== from);
}

function parsed(text: string | null): Record<string, ScopeSpec[]> | undefined {
  try {
    return text ? (JSON.parse(text) as Record<string, ScopeSpec[]>) : undefined;
  } catch {
    return undefined;
  }
}
