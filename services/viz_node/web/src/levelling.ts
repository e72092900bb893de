/** What is taken off measured heights before they are shown. */
export const LEVELLINGS = { none: "as measured", plane: "plane", lines: "median of lines", slopes: "slope of lines" } as const;
export type Levelling = keyof typeof LEVELLINGS;

/**
 * Heights less what a levelling takes off, of shape (lines, points) like those given; lines that were not measured stay.
 * `plane` is the plane of least squares through all of them; `lines` the median of each line; `slopes` the straight line
 * of least squares through each.
 */
export function levelled(heights: Float32Array, filled: readonly boolean[], points: number, levelling: Levelling): Float32Array<ArrayBuffer> {
  const found = new Float32Array(heights);
  const rows = filled.flatMap((is, row) => (is ? [row] : []));
  if (levelling === "plane") takePlane(found, rows, points);
  for (const row of rows) {
    const line = found.subarray(row * points, (row + 1) * points);
    if (levelling === "lines") shift(line, median(line));
    else if (levelling === "slopes") takeSlope(line);
  }
  return found;
}

function takePlane(heights: Float32Array, rows: readonly number[], points: number): void {
  if (rows.length < 2) return;
  const middle = { x: (points - 1) / 2, y: rows.reduce((sum, row) => sum + row, 0) / rows.length };
  // columns and lines are the same places for each other, so the two slopes are independent of one another
  let [sum, alongX, alongY, squareX, squareY] = [0, 0, 0, 0, 0];
  for (const row of rows) {
    for (let i = 0; i < points; i++) {
      const z = heights[row * points + i]!;
      sum += z;
      alongX += z * (i - middle.x);
      alongY += z * (row - middle.y);
      squareX += (i - middle.x) ** 2;
      squareY += (row - middle.y) ** 2;
    }
  }
  const mean = sum / (rows.length * points);
  const [slopeX, slopeY] = [alongX / squareX, alongY / squareY];
  for (const row of rows) {
    for (let i = 0; i < points; i++) heights[row * points + i]! -= mean + slopeX * (i - middle.x) + slopeY * (row - middle.y);
  }
}

function takeSlope(line: Float32Array): void {
  const middle = (line.length - 1) / 2;
  let [sum, along, square] = [0, 0, 0];
  line.forEach((z, i) => {
    sum += z;
    along += z * (i - middle);
    square += (i - middle) ** 2;
  });
  const [mean, slope] = [sum / line.length, along / square];
  line.forEach((z, i) => (line[i] = z - mean - slope * (i - middle)));
}

function shift(line: Float32Array, by: number): void {
  line.forEach((z, i) => (line[i] = z - by));
}

function median(line: Float32Array): number {
  const sorted = Float32Array.from(line).sort();
  const half = sorted.length >> 1;
  return sorted.length % 2 ? sorted[half]! : (sorted[half - 1]! + sorted[half]!) / 2;
}
