import type { Facts } from "./protocol";

/** What a number of a form may be, from the JSON Schema of the node that takes it. */
export interface Setting {
  key: string;
  kind: "number" | "integer" | "boolean" | "text";
  unit: string;
  label: string;
  about: string;
  initial: number | boolean | string | null;
  /** What a value in SI units is multiplied by to be shown in `unit`. */
  scale: number;
  /** Limits in `unit`. */
  min?: number;
  max?: number;
  /** The texts that it may be; any where there are none. */
  choices?: string[];
}

/** Units by the end of a key: the longest that fits. */
const UNITS: readonly (readonly [string, string])[] = [
  ["_n_per_m1_5", "N/m^1.5"],
  ["_n_s_per_m", "N s/m"],
  ["_n_per_m_s", "N/(m s)"],
  ["_n_per_s", "N/s"],
  ["_n_per_m", "N/m"],
  ["_m_per_s", "m/s"],
  ["_sqrt_w", "√W"],
  ["_bytes_per_s", "B/s"],
  ["_kbit_per_s", "kbit/s"],
  ["_per_s", "1/s"],
  ["_kg", "kg"],
  ["_s", "s"],
  ["_m", "m"],
  ["_n", "N"],
  ["_j", "J"],
];

/** Units in which people speak of an instrument and of a network: one for each quantity. */
const SHOWN: Record<string, readonly [string, number]> = { s: ["ms", 1e3], m: ["nm", 1e9], N: ["nN", 1e9], "m/s": ["nm/s", 1e9] };
/** Of a law lengths and forces are those of the hand, and of a link there are times alone. */
const OF_HAND: Record<string, readonly [string, number]> = { s: ["ms", 1e3] };

type Schema = Record<string, unknown>;

/** Settings of a section of a schema, by dotted key; sections within it and lists are left out. */
export function settings(root: Facts, section: string, of: "hand" | "instrument" = "hand"): Setting[] {
  let found = root as Schema;
  for (const name of section.split(".").filter(Boolean)) {
    found = resolved(root, ((found["properties"] ?? {}) as Record<string, Schema>)[name] ?? {});
  }
  const properties = (found["properties"] ?? {}) as Record<string, Schema>;
  return Object.entries(properties).flatMap(([name, schema]) => {
    const setting = settingOf(section ? `${section}.${name}` : name, name, schema, of === "hand" ? OF_HAND : SHOWN);
    return setting ? [setting] : [];
  });
}

/** Programs that the instrument can begin: the words of its key `program` that have a section, with the section's title. */
export function programsOf(root: Facts): { name: string; title: string }[] {
  const sections = ((root as Schema)["properties"] ?? {}) as Record<string, Schema>;
  const choices = (sections["program"]?.["anyOf"] as Schema[] | undefined)?.flatMap((choice) => (choice["enum"] as string[] | undefined) ?? []) ?? [];
  return choices.filter((name) => name in sections).map((name) => ({ name, title: String(sections[name]!["title"] ?? name) }));
}

function resolved(root: Schema, schema: Schema): Schema {
  const reference = schema["$ref"];
  if (typeof reference !== "string") return schema;
  return ((root["$defs"] ?? {}) as Record<string, Schema>)[reference.slice(reference.lastIndexOf("/") + 1)] ?? {};
}

/** The end of a key that is its unit, and the unit; undefined for none. */
export function unitOf(name: string): (typeof UNITS)[number] | undefined {
  // A quotient that is not in the list has no unit here, rather than that of its divisor.
  return UNITS.find(([end]) => name.endsWith(end) && !name.endsWith(`_per${end}`));
}

/** The words of a key, without its unit. */
export function nameOf(name: string): string {
  return name.slice(0, name.length - (unitOf(name)?.[0].length ?? 0)).replaceAll("_", " ");
}

function settingOf(key: string, name: string, schema: Schema, units: typeof SHOWN): Setting | undefined {
  const choices = (schema["anyOf"] as Schema[] | undefined)?.filter((choice) => choice["type"] !== "null");
  const plain = choices?.length === 1 ? { ...schema, ...choices[0] } : schema;
  const type = plain["type"];
  const kind = type === "number" || type === "integer" || type === "boolean" ? type : type === "string" ? "text" : undefined;
  if (!kind) return undefined;
  const unit = unitOf(name);
  const [shownUnit, scale] = units[unit?.[1] ?? ""] ?? [unit?.[1] ?? "", 1];
  const [min, max] = [plain["minimum"] ?? plain["exclusiveMinimum"], plain["maximum"] ?? plain["exclusiveMaximum"]];
  return {
    key,
    kind,
    unit: shownUnit,
    scale,
    label: nameOf(name),
    about: String(plain["description"] ?? ""),
    initial: (plain["default"] ?? null) as Setting["initial"],
    ...(Array.isArray(plain["enum"]) && { choices: plain["enum"].map(String) }),
    ...(typeof min === "number" && { min: +(min * scale).toPrecision(12) }),
    ...(typeof max === "number" && { max: +(max * scale).toPrecision(12) }),
  };
}
