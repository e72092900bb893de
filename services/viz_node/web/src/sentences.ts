import { guardText } from "./guard";
import { nameOf, unitOf } from "./schema";

/** What a node is called on the page, by the name that it has on the bus. */
const NAMES: Record<string, string> = {
  afm_node: "Tip",
  haptic_node: "Hand",
  controller: "Law",
  delay_node: "Link",
  launcher: "Session",
  recorder: "Recorder",
  viz_node: "Page",
  console: "Console",
  estop: "Emergency stop",
  relay: "Relay",
};
/** Smaller than this a number with its unit is none: nobody reads less, and it comes of the arithmetic. */
const NOTHING: Record<string, number> = { m: 1e-12, mm: 1e-3, "µm": 1e-3, nm: 0.05, pm: 0.05, N: 0.005, mN: 0.05, "µN": 0.05, nN: 0.005, pN: 0.5, "nm/s": 0.05, "mm/s": 0.005, "m/s": 1e-12, s: 5e-4, ms: 0.05, Hz: 0.005 };
const QUANTITY = /(?<![\w.])(-?\d+(?:\.\d+)?(?:e[-+]?\d+)?) (nm\/s|mm\/s|m\/s|nm|pm|µm|mm|m|nN|pN|µN|mN|N|ms|s|Hz)(?![\w/^])/gi;
const UNITS = new Set(Object.keys(NOTHING));

/** Units of which a small number is said with a prefix, and the least that is one: below it comes of the arithmetic. */
const SMALL: Record<string, number> = { m: 1e-12, N: 1e-13, s: 1e-7, "m/s": 1e-12 };
const PREFIXES: readonly (readonly [factor: number, prefix: string])[] = [[1e-3, "m"], [1e-6, "µ"], [1e-9, "n"], [1e-12, "p"]];
/** The key of a setting or of a state on the wire: words with a line between them, of a section or not. */
const KEY = /(?<![\w./@~-])((?:[a-z][a-z0-9_]*\.)*[a-z][a-z0-9]*(?:_[a-z0-9]+)+)(?![\w/@-]|\.\w)(?:( = -?[\d.]+(?:e[-+]?\d+)?)(?![\w.]| [A-Za-zµ√/]+))?/g;
const NODE = /(?<![\w./])([a-z_]+)@(?:master|slave)(?![\w/])/g;

/** A small number with the prefix of its unit: 200 and nN for 2e-07 N. */
function inPrefix(value: number, unit: string): [number, string] {
  const size = Math.abs(value);
  const found = size >= SMALL[unit]! && size < 1 ? PREFIXES.find(([factor]) => size >= factor) : undefined;
  return found ? [+(value / found[0]).toPrecision(3), `${found[1]}${unit}`] : [value, unit];
}

/** Who answers for control, before what it says: `window A holds control` says it whole. */
const OF_CONTROL = /(?<![\w./])lease: /g;

/** A sentence of a node in the words of the page: no name of the wire, no number of the arithmetic. */
export function plain(text: string): string {
  const named = guardText(text).replace(OF_CONTROL, "").replace(NODE, (_, name: string) => NAMES[name] ?? name.replaceAll("_", " "));
  const said = named.replace(KEY, (_, key: string, value = "") => {
    const unit = value && unitOf(key)?.[1];
    return `${key.split(".").map(nameOf).join(" ")}${value}${unit ? ` ${unit}` : ""}`;
  });
  return rounded(said);
}

/** Who says something, in the words of the page: `Tip` for afm_node@slave. */
export function speaker(src: string): string {
  const name = src.split("@")[0]!;
  return NAMES[name] ?? (name ? name[0]!.toUpperCase() + name.slice(1).replaceAll("_", " ") : "");
}

/** A sentence whose quantities have three digits at most, and in which what is none is 0. */
export function rounded(text: string): string {
  return text.replace(QUANTITY, (whole, number: string, unit: string) => {
    if (!UNITS.has(unit)) return whole;
    const value = Number(number);
    // a number of a setting in SI units, which nobody reads: 2e-07 N are 200 nN
    const [scaled, prefixed] = number.includes("e") && SMALL[unit] ? inPrefix(value, unit) : [value, unit];
    if (prefixed !== unit) return `${scaled} ${prefixed}`;
    if (Math.abs(value) < NOTHING[unit]!) return `0 ${unit}`;
    // whole numbers are what somebody typed, and stay as they are
    return /^-?\d+$/.test(number) ? whole : `${+value.toPrecision(3)} ${unit}`;
  });
}

/** What a node reported, as a sentence that begins with who says it. */
export function eventText(src: string, text: string): string {
  const who = speaker(src);
  const said = plain(text);
  return who && !said.startsWith(`${who} `) ? `${who}: ${said}` : said;
}
