import { make } from "./dom";
import { fixed } from "./numbers";

/** What `telenano link picture` writes of a network; null where it has no number. */
export interface LineCurves {
  course: [number[], (number | null)[], (number | null)[]];
  delay_ms: number[];
  age_ms: number[];
  memory: [number[], (number | null)[]];
}
export interface LineData {
  slower: number[];
  networks: Record<string, LineCurves>;
}

interface Chart {
  title: string;
  x: number[];
  ys: (number | null)[][];
  xLog: boolean;
  yLog: boolean;
  /** What the ends of the axes are called. */
  across: (value: number) => string;
  up: (value: number) => string;
}

const [WIDTH, HEIGHT, LEFT, BOTTOM, TOP, RIGHT] = [180, 100, 44, 16, 6, 6];
const NAMESPACE = "http://www.w3.org/2000/svg";

const plain = (value: number): string => String(+value.toPrecision(3));

/** The four charts of a network: delay over time, its distribution, its autocorrelation, the age at a reader. */
export function chartsOf(curves: LineCurves, slower: number[]): Chart[] {
  const [times, middle, longest] = curves.course;
  const seconds = (value: number): string => `${plain(value)} s`;
  const ms = (value: number): string => `${plain(value)} ms`;
  const share = (value: number): string => `${plain(100 * value)} %`;
  return [
    { title: "Delay, median and longest of 5 s", x: times, ys: [middle, longest], xLog: false, yLog: true, across: seconds, up: ms },
    { title: "Messages that take longer", x: curves.delay_ms, ys: [slower], xLog: true, yLog: true, across: ms, up: share },
    { title: "Autocorrelation of the delay", x: curves.memory[0], ys: [curves.memory[1]], xLog: true, yLog: false, across: seconds, up: plain },
    { title: "Newest sample older than, of the time", x: curves.age_ms, ys: [slower], xLog: true, yLog: true, across: ms, up: share },
  ];
}

/** The ends of an axis around its numbers; those of a logarithm leave out what has none. */
export function ends(values: (number | null)[], isLog: boolean): [number, number] {
  const known = values.filter((value): value is number => value !== null && (!isLog || value > 0));
  if (!known.length) return isLog ? [1, 10] : [0, 1];
  const [low, high] = [Math.min(...known), Math.max(...known)];
  if (low < high) return [low, high];
  return isLog ? [low / 2, low * 2] : [low - 0.5, low + 0.5];
}

/** Pieces of a line through points, in the places of the chart, broken where there is no number. */
export function pieces(x: number[], y: (number | null)[], [left, right]: [number, number], [low, high]: [number, number], xLog: boolean, yLog: boolean): string[] {
  const along = (value: number, from: number, to: number, isLog: boolean): number => (isLog ? Math.log(value / from) / Math.log(to / from) : (value - from) / (to - from));
  const found: string[][] = [[]];
  x.forEach((one, i) => {
    const other = y[i] ?? null;
    if (other === null || (xLog && one <= 0) || (yLog && other <= 0)) {
      found.push([]);
      return;
    }
    const place = LEFT + along(one, left, right, xLog) * (WIDTH - LEFT - RIGHT);
    const height = HEIGHT - BOTTOM - along(other, low, high, yLog) * (HEIGHT - BOTTOM - TOP);
    found.at(-1)!.push(`${fixed(place, 1)},${fixed(height, 1)}`);
  });
  return found.filter((piece) => piece.length > 1).map((piece) => piece.join(" "));
}

function shape(tag: string, attributes: Record<string, string | number>, text = ""): SVGElement {
  const found = document.createElementNS(NAMESPACE, tag);
  for (const [name, value] of Object.entries(attributes)) found.setAttribute(name, String(value));
  found.textContent = text;
  return found;
}

function drawn(chart: Chart): HTMLElement {
  const [left, right] = ends(chart.x, chart.xLog);
  const [low, high] = ends(chart.ys.flat(), chart.yLog);
  const svg = shape("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": chart.title });
  const [bottom, end] = [HEIGHT - BOTTOM, WIDTH - RIGHT];
  svg.append(
    shape("path", { d: `M${LEFT},${TOP}V${bottom}H${end}`, class: "axis" }),
    shape("text", { x: LEFT - 3, y: TOP + 6, "text-anchor": "end" }, chart.up(high)),
    shape("text", { x: LEFT - 3, y: bottom, "text-anchor": "end" }, chart.up(low)),
    shape("text", { x: LEFT, y: HEIGHT - 4 }, chart.across(left)),
    shape("text", { x: end, y: HEIGHT - 4, "text-anchor": "end" }, chart.across(right)),
  );
  chart.ys.forEach((y, number) => {
    for (const points of pieces(chart.x, y, [left, right], [low, high], chart.xLog, chart.yLog)) svg.append(shape("polyline", { points, class: `curve c${number + 1}` }));
  });
  return make("figure", {}, svg as unknown as Node, make("figcaption", { class: "quiet" }, chart.title));
}

/** The pictures of the network in force, which are loaded when the first one is asked for. */
export class LinePictures {
  private data: Promise<LineData> | undefined;
  private shown = "";

  constructor(
    readonly root: HTMLElement,
    private readonly load: () => Promise<LineData>,
  ) {}

  /** Show what is known of a network; nothing of one that was never drawn. */
  async show(name: string): Promise<void> {
    if (name === this.shown) return;
    this.shown = name;
    this.data ??= this.load();
    const data = await this.data.catch(() => undefined);
    if (data === undefined) {
      // the next network tries again
      this.data = undefined;
      this.root.hidden = true;
      return;
    }
    // another one may have been chosen meanwhile
    if (name !== this.shown) return;
    const curves = data.networks[name];
    this.root.hidden = curves === undefined;
    this.root.replaceChildren(...(curves ? chartsOf(curves, data.slower).map(drawn) : []));
  }
}
