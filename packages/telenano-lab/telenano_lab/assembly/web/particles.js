/** Spheres in an image, and what a tip beside one of them knows of it: plain arithmetic in nm and N. */
export const TIP = { radius: 10, cone: (15 * Math.PI) / 180 };

/** A place is taken as right within this, whatever the noise of an image [nm]. */
const LEAST_ERROR = 1;
/** A component is a sphere where it has so many pixels, and is higher than this share of the highest. */
const LEAST_PIXELS = 4;
const LEAST_SHARE = 0.3;
const ITERATIONS = 12;
/** The travel that is left is short below this share of d. */
export const SHORT = 0.5;

/** Height of the apex over a sphere whose middle is so far away [nm]; below 0 where it does not touch it. */
export function sphereHeight(radius, distance, tip = TIP) {
  const sum = radius + tip.radius;
  if (distance <= sum * Math.cos(tip.cone)) return radius - tip.radius + Math.sqrt(sum * sum - distance * distance);
  return radius - tip.radius + (sum / Math.cos(tip.cone) - distance) / Math.tan(tip.cone);
}

/** Distance d of the axes of a tip on the surface and a sphere that touch [nm]. */
export function touchDistance(radius, tip = TIP) {
  const sum = radius + tip.radius;
  const tilt = Math.max(tip.cone, Math.asin(Math.min(1, Math.max(-1, (tip.radius - radius) / sum))));
  if (tilt > tip.cone) return sum * Math.cos(tilt);
  return sum / Math.cos(tip.cone) + (radius - tip.radius) * Math.tan(tip.cone);
}

/** Travel of a straight push until the particle slips off, d ln cot(|phi| / 2) [nm]. */
export function travelLeft(distance, aside) {
  const half = Math.min(Math.abs(aside), Math.PI / 2) / 2;
  return half === 0 ? Infinity : Math.max(0, -distance * Math.log(Math.tan(half)));
}

/** Return the spheres of an image: components above a third of their height, fitted by least squares. */
export function findParticles(image, tip = TIP) {
  const { values, rows, columns } = image;
  const known = Float32Array.from(values.filter((value) => !Number.isNaN(value))).sort();
  if (!known.length) return [];
  const floor = known[Math.floor(known.length / 2)];
  const top = known.at(-1) - floor;
  const noise = floor - known[Math.floor(0.159 * known.length)];
  const threshold = floor + Math.max(LEAST_SHARE * top, 5 * noise);
  const seen = new Uint8Array(values.length);
  const found = [];
  for (let start = 0; start < values.length; start++) {
    if (seen[start] || !(values[start] > threshold)) continue;
    const pixels = [start];
    seen[start] = 1;
    for (let next = 0; next < pixels.length; next++) {
      const [row, column] = [Math.floor(pixels[next] / columns), pixels[next] % columns];
      for (const [r, c] of [[row - 1, column], [row + 1, column], [row, column - 1], [row, column + 1]]) {
        const i = r * columns + c;
        if (r < 0 || c < 0 || r >= rows || c >= columns || seen[i] || !(values[i] > threshold)) continue;
        seen[i] = 1;
        pixels.push(i);
      }
    }
    const sphere = pixels.length < LEAST_PIXELS ? undefined : fitted(image, pixels, floor, tip);
    if (sphere) found.push(sphere);
  }
  return found;
}

/** Fit middle and radius of a sphere to some pixels (Gauss and Newton); undefined where that leads nowhere. */
function fitted({ values, rows, columns, extent }, pixels, floor, tip) {
  const at = pixels.map((i) => ({
    x: extent.x + extent.width * ((i % columns) / (columns - 1) - 0.5),
    y: extent.y + extent.depth * (Math.floor(i / columns) / (rows - 1) - 0.5),
    z: values[i] - floor,
  }));
  const weight = at.reduce((sum, { z }) => sum + z, 0);
  let p = [at.reduce((sum, { x, z }) => sum + x * z, 0) / weight, at.reduce((sum, { y, z }) => sum + y * z, 0) / weight, Math.max(...at.map(({ z }) => z)) / 2];
  const model = (q, x, y) => sphereHeight(q[2], Math.hypot(x - q[0], y - q[1]), tip);
  let inverse;
  let squares = 0;
  for (let n = 0; n < ITERATIONS; n++) {
    const normal = [[0, 0, 0], [0, 0, 0], [0, 0, 0]];
    const right = [0, 0, 0];
    squares = 0;
    for (const { x, y, z } of at) {
      const value = model(p, x, y);
      const slopes = p.map((_, k) => (model(p.map((v, j) => (j === k ? v + 0.01 : v)), x, y) - value) / 0.01);
      squares += (z - value) ** 2;
      for (let i = 0; i < 3; i++) {
        right[i] += slopes[i] * (z - value);
        for (let j = 0; j < 3; j++) normal[i][j] += slopes[i] * slopes[j];
      }
    }
    inverse = inverted(normal);
    if (!inverse) return undefined;
    const step = inverse.map((row) => row.reduce((sum, value, i) => sum + value * right[i], 0));
    p = p.map((value, i) => value + step[i]);
    if (Math.hypot(...step) < 1e-3) break;
  }
  const [x, y, radius] = p;
  if (!(radius > 0) || Math.abs(x - extent.x) > extent.width || Math.abs(y - extent.y) > extent.depth) return undefined;
  const variance = squares / Math.max(1, at.length - 3);
  return { x, y, radius, error: Math.hypot(LEAST_ERROR, Math.sqrt(Math.max(0, variance * Math.max(inverse[0][0], inverse[1][1])))) };
}

function inverted(m) {
  const [[a, b, c], [d, e, f], [g, h, i]] = m;
  const determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g);
  if (!Number.isFinite(determinant) || Math.abs(determinant) < 1e-30) return undefined;
  const adjugate = [
    [e * i - f * h, c * h - b * i, b * f - c * e],
    [f * g - d * i, a * i - c * g, c * d - a * f],
    [d * h - e * g, b * g - a * h, a * e - b * d],
  ];
  return adjugate.map((row) => row.map((value) => value / determinant));
}

/** Whether a push along a line would meet another particle: the way of the pushed one and of the tip behind it [nm]. */
export function isBlocked(from, to, others) {
  const length = Math.hypot(to.x - from.x, to.y - from.y);
  const [ux, uy] = [(to.x - from.x) / length, (to.y - from.y) / length];
  return others.some((other) => {
    const [x, y] = [other.x - from.x, other.y - from.y];
    const along = Math.min(length, Math.max(-1.3 * touchDistance(from.radius), x * ux + y * uy));
    return Math.hypot(x - along * ux, y - along * uy) < from.radius + other.radius + 2 * (from.error + other.error);
  });
}
