/** Viridis (S. van der Walt, N. Smith, 2015): perceptually uniform, and legible to the colour-blind. Anchors of its 256. */
const ANCHORS: readonly (readonly [number, number, number])[] = [
  [68, 1, 84],
  [72, 36, 117],
  [65, 68, 135],
  [53, 95, 141],
  [42, 120, 142],
  [33, 145, 140],
  [34, 168, 132],
  [68, 191, 112],
  [122, 209, 81],
  [189, 223, 38],
  [253, 231, 37],
];

/** Colour of a share from 0 to 1, components from 0 to 1; shares beyond take the colour of the end. */
export function viridis(share: number): [number, number, number] {
  const place = Math.min(1, Math.max(0, Number.isNaN(share) ? 0 : share)) * (ANCHORS.length - 1);
  const low = Math.min(ANCHORS.length - 2, Math.floor(place));
  const part = place - low;
  const [a, b] = [ANCHORS[low]!, ANCHORS[low + 1]!];
  return [0, 1, 2].map((i) => (a[i]! + (b[i]! - a[i]!) * part) / 255) as [number, number, number];
}

/** The colour map as a CSS gradient, upwards. */
export function gradient(): string {
  return `linear-gradient(to top, ${ANCHORS.map((rgb) => `rgb(${rgb.join(",")})`).join(",")})`;
}
