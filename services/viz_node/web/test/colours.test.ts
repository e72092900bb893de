import { readFileSync } from "node:fs";
import { describe, expect, it } from "vitest";
import { MEANINGS } from "../src/colours";

const sheet = readFileSync(new URL("../src/styles.css", import.meta.url), "utf8");
/** What has no hue of its own: surfaces, text, and lines; a fill that is as dark as text is what comes next. */
const NEUTRAL = new Set(["back", "panel", "inset", "line", "edge", "text", "quiet", "scene", "on-accent", "accent"]);

/** The colours of a block of the stylesheet, by their tokens; what only names another token is left out. */
function tokens(selector: string): Map<string, string> {
  const begin = sheet.indexOf(`${selector} {`);
  const block = sheet.slice(begin, sheet.indexOf("}", begin));
  return new Map([...block.matchAll(/--([\w-]+): (#[0-9a-f]{6});/g)].map(([, name, value]) => [name!, value!]));
}

const light = tokens(":root");
const dark = new Map([...light, ...tokens(':root[data-theme="dark"]')]);

const linear = (hex: string): number[] => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255).map((value) => (value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4));

/** Relative luminance by WCAG 2.2, and the contrast of two colours. */
const luminance = (hex: string): number => linear(hex).reduce((sum, value, i) => sum + value * [0.2126, 0.7152, 0.0722][i]!, 0);
function contrast(one: string, other: string): number {
  const [low, high] = [luminance(one), luminance(other)].sort((a, b) => a - b) as [number, number];
  return (high + 0.05) / (low + 0.05);
}

/** The distance of two colours as eyes see it (OKLab). */
function distance(one: string, other: string): number {
  const lab = (hex: string): number[] => {
    const [r, g, b] = linear(hex) as [number, number, number];
    const [l, m, s] = [0.4122214708 * r + 0.5363325363 * g + 0.0514459929 * b, 0.2119034982 * r + 0.6806995451 * g + 0.1073969566 * b, 0.0883024619 * r + 0.2817188376 * g + 0.6299787005 * b].map(Math.cbrt) as [number, number, number];
    return [0.2104542553 * l + 0.793617785 * m - 0.0040720468 * s, 1.9779984951 * l - 2.428592205 * m + 0.4505937099 * s, 0.0259040371 * l + 0.7827717662 * m - 0.808675766 * s];
  };
  const [a, b] = [lab(one), lab(other)];
  return Math.hypot(...a.map((value, i) => value - b[i]!));
}

describe.each([["light", light], ["dark", dark]] as const)("the colours of the %s theme", (_, theme) => {
  it("each have one meaning in the legend, and each meaning has a colour", () => {
    const named = MEANINGS.flatMap((meaning) => meaning.tokens);
    expect(new Set(named).size).toBe(named.length);
    const coloured = [...theme.keys()].filter((name) => !NEUTRAL.has(name) && name !== "sample-back");
    expect([...coloured].sort()).toEqual(named.filter((name) => name !== "accent").sort());
  });

  it("of different meanings cannot be taken for each other", () => {
    const shown = MEANINGS.map((meaning) => [meaning.tokens[0]!, theme.get(meaning.tokens[0]!)!] as const);
    for (const [i, [one, value]] of shown.entries()) for (const [other, another] of shown.slice(i + 1)) expect(distance(value, another), `${one} and ${other}`).toBeGreaterThan(0.08);
  });

  it("can be read on the surfaces that they stand on", () => {
    const surfaces = ["panel", "inset"].map((name) => theme.get(name)!);
    for (const name of ["text", "quiet", "hand", "tip", "water", "lateral", "extra", "good", "warn", "bad"]) {
      for (const surface of surfaces) expect(contrast(theme.get(name)!, surface), name).toBeGreaterThanOrEqual(4.5);
    }
    for (const kind of ["good", "warn", "bad"]) expect(contrast(theme.get(kind)!, theme.get(`${kind}-back`)!), kind).toBeGreaterThanOrEqual(4.5);
    expect(contrast(theme.get("on-accent")!, theme.get("accent")!)).toBeGreaterThanOrEqual(7);
    expect(contrast("#ffffff", theme.get("stop")!)).toBeGreaterThanOrEqual(4.5);
    expect(contrast(theme.get("text")!, theme.get("sample-back")!)).toBeGreaterThanOrEqual(4.5);
    // a control is seen by its edge
    expect(contrast(theme.get("edge")!, theme.get("panel")!)).toBeGreaterThanOrEqual(3);
  });
});
