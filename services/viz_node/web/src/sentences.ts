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
const NOTHING: Record<string, number> = { m: 1e-12, mm: 1e-3, "µm": 1e-3, nm: 0.05, pm: 0.05, N: 0.005, mN: 0.05, "µN": 0.05, nN: 0.005, pN: 0.5, "nm/s": 0.05, "mm/s": 0.005, s: 5e-4, ms: 0.05, Hz: 0.005 };
const QUANTITY = /(?<![\w.])(-?\d+(?:\.\d+)?(?:e[-+]?\d+)?) (nm\/s|mm\/s|nm|pm|µm|mm|m|nN|pN|µN|mN|N|ms|s|Hz)(?![\w/^])/gi;
const UNITS = new Set(Object.keys(NOTHING));

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
    if (Math.abs(value) < NOTHING[unit]!) return `0 ${unit}`;
    // whole numbers are what somebody typed, and stay as they are
    return /^-?\d+$/.test(number) ? whole : `${+value.toPrecision(3)} ${unit}`;
  });
}

/** What a node reported, as a sentence that begins with who says it. */
export function eventText(src: string, text: string): string {
  const who = speaker(src);
  return who ? `${who}: ${rounded(text)}` : rounded(text);
}
