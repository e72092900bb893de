/** Places and texts of ticks between two numbers, about four of them, at 1, 2 or 5 times a power of ten. */
export function ticks(min: number, max: number): [number, string][] {
  const rough = (max - min) / 4;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((candidate) => candidate >= rough) ?? rough;
  const found: [number, string][] = [];
  for (let i = Math.ceil(min / step); i * step <= max; i++) found.push([i * step, `${+(i * step).toPrecision(3) + 0}`]);
  return found;
}
