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

/** As Gwyddion and its kin show heights: from black over brown to white. */
const BROWN: readonly (readonly [number, number, number])[] = [
  [0, 0, 0],
  [120, 48, 12],
  [214, 132, 44],
  [250, 214, 140],
  [255, 255, 255],
];
const GREY: readonly (readonly [number, number, number])[] = [
  [0, 0, 0],
  [255, 255, 255],
];

export const PALETTES = { viridis: ANCHORS, brown: BROWN, grey: GREY } as const;
export type Palette = keyof typeof PALETTES;

/** Colour of a share from 0 to 1 in a palette, components from 0 to 1; shares beyond take the colour of the end. */
export function colourOf(palette: Palette, share: number): [number, number, number] {
  const anchors = PALETTES[palette];
  const place = Math.min(1, Math.max(0, Number.isNaN(share) ? 0 : share)) * (anchors.length - 1);
  const low = Math.min(anchors.length - 2, Math.floor(place));
  const part = place - low;
  const [a, b] = [anchors[low]!, anchors[low + 1]!];
  return [0, 1, 2].map((i) => (a[i]! + (b[i]! - a[i]!) * part) / 255) as [number, number, number];
}

export function viridis(share: number): [number, number, number] {
  return colourOf("viridis", share);
}

/** A palette as a CSS gradient, upwards. */
export function gradient(palette: Palette = "viridis"): string {
  return `linear-gradient(to top, ${PALETTES[palette].map((rgb) => `rgb(${rgb.join(",")})`).join(",")})`;
}
