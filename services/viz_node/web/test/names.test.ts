import { expect, test } from "vitest";

const SOURCES = import.meta.glob<string>("../src/**/*.ts", { query: "?raw", import: "default", eager: true });
const NAMES = Object.values(SOURCES).flatMap((source) => [...source.matchAll(/\bid: "([a-z-]+)"/g)].map((found) => found[1]));

test("no two elements or panels of the page have the same id", () => {
  expect(NAMES.length).toBeGreaterThan(30);
  expect(NAMES.filter((name, at) => NAMES.indexOf(name) !== at)).toEqual([]);
});
