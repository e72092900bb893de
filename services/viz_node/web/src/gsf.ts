const TEXT = new TextEncoder();

/**
 * A Gwyddion Simple Field of heights [m], a row each, y rising with the row: a header in words, zeros up to a multiple of
 * four, and 32-bit numbers from the top of the picture down.
 */
export function simpleField(about: Readonly<Record<string, string | number>>, rows: readonly Float32Array[]): Uint8Array<ArrayBuffer> {
  const points = rows[0]?.length ?? 0;
  const facts = Object.entries({ XRes: points, YRes: rows.length, XYUnits: "m", ZUnits: "m", ...about });
  const header = TEXT.encode(`Gwyddion Simple Field 1.0\n${facts.map(([key, value]) => `${key} = ${String(value).replace(/\s+/g, " ")}\n`).join("")}`);
  const begin = header.length + 4 - (header.length % 4);
  const whole = new Uint8Array(begin + 4 * points * rows.length);
  whole.set(header);
  const view = new DataView(whole.buffer, begin);
  rows.toReversed().forEach((row, line) => row.forEach((height, point) => view.setFloat32(4 * (line * points + point), height, true)));
  return whole;
}
