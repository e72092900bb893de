import { expect, it } from "vitest";
import { findParticles, isBlocked, sphereHeight, touchDistance, travelLeft } from "../../telenano_lab/assembly/web/particles.js";

function image(places: readonly (readonly [number, number])[], noise = 0, radius = 250) {
  const [rows, columns, side] = [49, 65, 4000];
  let seed = 7;
  const random = (): number => (seed = (seed * 16807) % 2147483647) / 2147483647 - 0.5;
  const values = Float32Array.from({ length: rows * columns }, (_, i) => {
    const x = 100 + side * ((i % columns) / (columns - 1) - 0.5);
    const y = -50 + 0.75 * side * (Math.floor(i / columns) / (rows - 1) - 0.5);
    return Math.max(0, ...places.map(([u, v]) => sphereHeight(radius, Math.hypot(x - u, y - v)))) + 3.46 * noise * random();
  });
  return { values, rows, columns, extent: { x: 100, y: -50, width: side, depth: 0.75 * side } };
}

it("has the distances of the closed forms", () => {
  expect(touchDistance(250)).toBeCloseTo(333.48, 2);
  expect(touchDistance(50)).toBeCloseTo(72.8345, 3);
  expect(sphereHeight(250, 0.5 * 333.48)).toBeCloseTo(439.494, 2);
  expect(travelLeft(1, (5 * Math.PI) / 180)).toBeCloseTo(3.1313, 4);
  expect(travelLeft(1, Math.PI)).toBeCloseTo(0);
});

it("finds places and radii, without noise to a hundredth and with 1 nm of it to a nanometre", () => {
  const places = [[-800, 300], [430, -220], [900, 610]] as const;
  for (const [noise, within] of [[0, 0.01], [1, 1]] as const) {
    const found = findParticles(image(places, noise)).sort((a, b) => a.x - b.x);
    expect(found.length).toBe(3);
    found.forEach((particle, i) => {
      expect(Math.hypot(particle.x - places[i]![0], particle.y - places[i]![1])).toBeLessThan(within);
      expect(Math.abs(particle.radius - 250)).toBeLessThan(within);
    });
  }
});

it("finds nothing where nothing is, and none in lines that were not measured", () => {
  expect(findParticles({ ...image([]), values: new Float32Array(49 * 65).fill(NaN) })).toEqual([]);
  const half = image([[0, 300]]);
  half.values.fill(NaN, 30 * 65);
  expect(findParticles(half).length).toBeLessThanOrEqual(1);
});

it("knows which particle is in the way of another, behind it as well", () => {
  const at = (x: number, y: number): Particle => ({ x, y, radius: 250, error: 1 });
  expect(isBlocked(at(0, 0), { x: 2000, y: 0 }, [at(1000, 300)])).toBe(true);
  expect(isBlocked(at(0, 0), { x: 2000, y: 0 }, [at(1000, 600)])).toBe(false);
  expect(isBlocked(at(0, 0), { x: 2000, y: 0 }, [at(-600, 0)])).toBe(true);
});
