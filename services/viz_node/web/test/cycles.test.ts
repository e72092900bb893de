import { expect, it } from "vitest";
import { CycleCounter } from "../src/cycles";

it("counts presses that rise and fall, and neither a ramp nor noise", () => {
  const cycles = new CycleCounter();
  for (let n = 0; n <= 100; n += 1) cycles.see(n / 100 + (n % 2 ? 0.04 : 0));
  expect(cycles.count).toBe(0);
  for (let n = 0; n < 400; n += 1) cycles.see(1 + 0.3 * Math.sin((2 * Math.PI * n) / 80));
  expect(cycles.count).toBe(5);
  cycles.see(NaN);
  expect(cycles.count).toBe(5);
});
