import { expect, it } from "vitest";
import { simpleField } from "../src/gsf";

it("a simple field has its header, zeros up to a multiple of four, and its rows from the top down", () => {
  const file = simpleField({ XReal: 2e-7, YReal: 1e-7, Title: "Height\nless plane" }, [Float32Array.of(1, 2, 3), Float32Array.of(4, 5, 6)]);
  const end = file.indexOf(0);
  const text = new TextDecoder().decode(file.subarray(0, end));
  expect(text).toBe("Gwyddion Simple Field 1.0\nXRes = 3\nYRes = 2\nXYUnits = m\nZUnits = m\nXReal = 2e-7\nYReal = 1e-7\nTitle = Height less plane\n");
  const begin = end + 4 - (end % 4);
  expect([...new Float32Array(file.slice(begin).buffer)]).toEqual([4, 5, 6, 1, 2, 3]);
});
