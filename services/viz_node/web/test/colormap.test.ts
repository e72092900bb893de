import { expect, it } from "vitest";
import { viridis } from "../src/colormap";

/** Lightness L* of CIELAB from sRGB components. */
function lightness(rgb: [number, number, number]): number {
  const linear = rgb.map((c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4));
  const y = 0.2126 * linear[0]! + 0.7152 * linear[1]! + 0.0722 * linear[2]!;
  return y > 0.008856 ? 116 * Math.cbrt(y) - 16 : 903.3 * y;
}

it("grows lighter evenly, so that equal steps of height look equal", () => {
  const steps = Array.from({ length: 100 }, (_, i) => lightness(viridis((i + 1) / 100)) - lightness(viridis(i / 100)));
  expect(Math.min(...steps)).toBeGreaterThan(0);
  expect(Math.max(...steps)).toBeLessThan(2.2 * (steps.reduce((a, b) => a + b) / steps.length));
});

it("takes the colour of the end beyond it, and of the lowest for what is no number", () => {
  expect(viridis(-3)).toEqual(viridis(0));
  expect(viridis(7)).toEqual(viridis(1));
  expect(viridis(NaN)).toEqual(viridis(0));
});
