import { expect, test } from "vitest";
import { programsOf, settings } from "../src/schema";

const schema = {
  $defs: { Circle: { properties: { radius_m: { type: "number", default: 2e-8, minimum: 1e-9, description: "Radius of the circle [m]." } } } },
  properties: {
    program: { anyOf: [{ enum: ["scan", "circle", "abort"], type: "string" }, { type: "null" }] },
    scan: { $ref: "#/$defs/Circle", title: "Scan" },
    circle: { $ref: "#/$defs/Circle", title: "Circle" },
    lateral: { $ref: "#/$defs/Circle", title: "Lateral" },
  },
};

test("the programs of the page are those that the instrument says it has, of packages too", () => {
  expect(programsOf(schema)).toEqual([{ name: "scan", title: "Scan" }, { name: "circle", title: "Circle" }]);
  expect(programsOf({})).toEqual([]);
  expect(settings(schema, "circle")).toMatchObject([{ key: "circle.radius_m", unit: "m", label: "radius", initial: 2e-8, min: 1e-9 }]);
  // of an instrument in the units in which people speak of it
  expect(settings(schema, "circle", "instrument")).toMatchObject([{ unit: "nm", scale: 1e9, initial: 2e-8, min: 1 }]);
});

test("a quotient is not shown in the unit of its divisor", () => {
  const number = { type: "number", default: 0.5, description: "Some number." };
  const gains = { properties: { gain_per_s: number, sensitivity_per_m: number, speed_m_per_s: number } };
  expect(settings(gains, "", "instrument")).toMatchObject([
    { unit: "1/s", scale: 1, label: "gain", initial: 0.5 },
    { unit: "", scale: 1, label: "sensitivity per m" },
    { unit: "nm/s", scale: 1e9, label: "speed" },
  ]);
});
