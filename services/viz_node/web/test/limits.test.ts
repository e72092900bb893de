import { readFileSync } from "node:fs";
import { expect, test } from "vitest";
import { FELT_LIMITS, HAND_LIMITS, limitsOf, limitsText, TIP_LIMITS, travelText } from "../src/limits";

/** The values that a field of a message may have, by the schema of the wire. */
function values(message: string, field: string): string[] {
  const schema = JSON.parse(readFileSync(new URL(`../../../../proto/schemas/${message}.json`, import.meta.url), "utf8")) as object;
  const found: string[] = [];
  const seek = (node: unknown, isInside: boolean): void => {
    if (typeof node !== "object" || node === null) return;
    for (const [key, value] of Object.entries(node)) {
      if (isInside && key === "enum") found.push(...(value as string[]).filter(Boolean));
      else seek(value, isInside || key === field);
    }
  };
  seek(schema, false);
  return found.sort();
}

test.each([
  ["HapticState", "limited_by", HAND_LIMITS],
  ["AfmState", "limited_by", TIP_LIMITS],
  ["AfmState", "felt_clamp", FELT_LIMITS],
])("every limit that %s reports in %s has words and a way out", (message, field, table) => {
  expect(values(message, field)).not.toEqual([]);
  expect(Object.keys(table).sort()).toEqual(values(message, field));
  for (const { words, out } of Object.values(table)) expect(words && out).not.toBe("");
});

test("the limits that act are said, and that of a way whose speed is chosen is not", () => {
  expect(limitsText(limitsOf("travel", undefined, "", true))).toBe("The hand is at the end of its travel: lift it");
  expect(limitsOf(undefined, "speed", undefined, false)).toEqual([]);
  expect(limitsText(limitsOf("speed", "area", "saturated", true)).split(". ")).toHaveLength(3);
  expect(limitsText([])).toBe("");
});

test("what is left of the travel is said both ways", () => {
  expect(travelText(7.4e-3, [-4.5e-3, 14.5e-3])).toEqual({ short: "7.1 mm left", long: "The hand can still go 7.1 mm down and 11.9 mm up" });
  expect(travelText(15e-3, [-4.5e-3, 14.5e-3]).short).toBe("0.0 mm left");
  expect([travelText(NaN, [-1, 1]).short, travelText(0, undefined).short]).toEqual(["", ""]);
});
