import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { colour, make } from "../dom";
import { grid, minMax, type Point } from "../ring";
import type { Store } from "../store";
import { TICK_PX, tickPlaces, tickTexts } from "../ticks";
import { drawnTogether, SHORT, type Drawn } from "./catalog";
import { ForceDistance } from "./force_distance";
import { ageWords } from "../freshness";
import type { ScopeSpec } from "./layout";
import { axisRange, extentOf, heldAxis, isNothing, noiseOf, type HeldAxis } from "./range";
import { gapOf, readAt, samplesOf, type Reading, type Samples } from "./reading";
import { resampled, spectrumOf } from "./spectrum";
import { fixed } from "../numbers";

const SPECTRUM_POINTS = 4096;
/** The column of the tip that is 1 while it follows: how it is placed and withdrawn does not count for an axis. */
const FOLLOWS = "follows";
/** Dashes of a curve [px]. */
const DASHES = [5, 3];
/** Room beside the plot for half of the last number of the time with its unit [px]. */
const MARGIN_PX = 18;

/** The part of the time that all scopes show, and what is marked in it [s]. */
export interface Window extends Samples {
  from: number;
  to: number;
  /** Subtracted from times before they are written: the end of a window that moves, 0 in a recording. */
  zero: number;
  /** The playhead of a recording. */
  now: number | undefined;
  cursors: readonly [number, number] | undefined;
  moments: readonly number[];
  /** How old the newest sample of a stream is, where that is not of the present [s]; 0 where it is. */
  age(stream: string): number;
}

/** One scope: curves over time, their spectrum, or force against distance. */
export class Plot {
  readonly area = make("div", { class: "area", tabindex: 0, role: "img" });
  /** Whether it is in the part of the page that is seen: what is not seen is not drawn. */
  isSeen = true;
  /** Called with a time at which the pointer pressed [s], and whether it is a new press. */
  onTime: (time: number, begins: boolean) => void = () => {};
  private plot: uPlot | undefined;
  private readonly distance: ForceDistance | undefined;
  private data: uPlot.AlignedData = [[]];
  private window: Window | undefined;
  private axesHeld: Record<number, HeldAxis> = {};
  /** Whether all that an axis shows is 0, but for what is less than its floor. */
  private isNothing: Record<number, boolean> = {};
  /** Least and greatest of each curve where it counts. */
  private extents: ([number, number] | undefined)[] = [];
  /** Called with the time under the pointer [s], undefined when it leaves. */
  onHover: (time: number | undefined) => void = () => {};
  private readonly drawn: Drawn[];
  private readonly units: string[];
  private readonly values = make("div", { class: "at-cursor", hidden: true });

  constructor(
    readonly spec: ScopeSpec,
    private readonly store: Store,
  ) {
    this.drawn = drawnTogether(store, spec.curves);
    this.units = [...new Set(this.drawn.map(({ unit }) => unit))];
    this.area.setAttribute("aria-label", this.title);
    if (spec.kind === "distance") {
      this.distance = new ForceDistance(store);
      this.area.append(this.distance.area);
      this.distance.area.style.height = "100%";
    } else {
      this.area.append(this.values);
      this.plot = this.build();
      this.listen();
    }
  }

  get title(): string {
    if (this.spec.kind === "distance") return `${this.spec.title}, nN over nm`;
    return `${this.spec.title}, ${this.units.filter(Boolean).join("; ")}${this.spec.kind === "spectrum" ? " over Hz" : ""}`;
  }

  /** Names of the curves, long and short, with the tokens of their colours, and whether they are dashed. */
  get keys(): { label: string; short: string; colour: string; isDashed: boolean }[] {
    if (this.spec.kind === "distance") return [{ label: "towards the sample", short: "down", colour: "tip", isDashed: false }, { label: "away from it", short: "up", colour: "quiet", isDashed: false }];
    return this.drawn.map(({ label, colour, isDashed }) => ({ label, short: SHORT[label] ?? label, colour, isDashed }));
  }

  /** Show what stands at the time that the pointer is at in another scope [s]. */
  hover(time: number | undefined): void {
    if (!this.distance) return;
    const reading = time === undefined || !this.window ? undefined : readAt(this.window, columnsOf(this.store), time, "tip");
    this.distance.show((reading?.values.get("tip.separation") ?? NaN) * 1e9, (reading?.values.get("tip.force") ?? NaN) * 1e9);
  }

  draw(window: Window): void {
    this.window = window;
    this.area.toggleAttribute("data-old", this.spec.kind !== "time" && this.spec.curves.some(({ stream }) => window.age(stream) > 0));
    if (this.distance) this.distance.draw(window.ring("tip"), window.from, window.to, window.width, window.now ?? window.to);
    else if (this.spec.kind === "spectrum") this.drawSpectrum(window);
    else this.drawTime(window);
  }

  resize(): void {
    const { clientWidth: width, clientHeight: height } = this.area;
    if (this.plot && width > 0 && height > 0 && (width !== this.plot.width || height !== this.plot.height)) this.plot.setSize({ width, height });
  }

  /** Build the plot again in the colours of the theme. */
  recolour(): void {
    if (!this.plot) return;
    this.plot.destroy();
    this.plot = this.build();
    this.plot.setData(this.data);
    this.listen();
  }

  destroy(): void {
    this.plot?.destroy();
  }

  picture(): HTMLCanvasElement {
    return this.plot?.ctx.canvas ?? this.distance!.canvas;
  }

  /** The stream whose samples the cursors of this scope stand at. */
  get stream(): string {
    return this.spec.curves[0]?.stream ?? "";
  }

  /** The curves over time by the names of their columns, and how each is drawn. */
  get measured(): { name: string; drawn: Drawn }[] {
    if (this.spec.kind !== "time") return [];
    return this.spec.curves.map(({ stream, column }, i) => ({ name: `${stream}.${column}`, drawn: this.drawn[i]! }));
  }

  /** What a cursor reads at a time [s]: the pointer shows the same. */
  read(time: number): Reading | undefined {
    return this.window && readAt(this.window, columnsOf(this.store), time, this.stream);
  }

  private drawTime(window: Window): void {
    const { from, to, zero, width } = window;
    const buckets = Math.max(50, Math.min(600, Math.round(this.plot!.width / 2)));
    const times = Array.from(grid(from, to, buckets), (time) => time - zero);
    const series = this.spec.curves.map((curve, i): Point[] => {
      const ring = window.ring(curve.stream);
      const column = this.store.column(curve.stream, curve.column);
      if (!ring || column < 0) return new Array<Point>(2 * buckets).fill(null);
      const gap = Math.max(gapOf(curve.stream), 2.5 * width);
      const points = minMax(ring, column, from, to, buckets, gap);
      const { scale } = this.drawn[i]!;
      return points.map((value) => (value == null ? value : value * scale));
    });
    const tip = window.ring("tip");
    const column = this.store.column("tip", FOLLOWS);
    const follows = tip && column >= 0 ? minMax(tip, column, from, to, buckets, Math.max(gapOf("tip"), 2.5 * width)) : undefined;
    this.extents = series.map((points, i) => extentOf(points, this.spec.curves[i]!.stream === "tip" ? follows : undefined));
    this.data = [times, ...series] as uPlot.AlignedData;
    this.plot!.setData(this.data, false);
    this.plot!.setScale("x", { min: from - zero, max: to - zero });
  }

  private drawSpectrum(window: Window): void {
    const { from, to, width } = window;
    const least = width > 0 ? Math.floor((to - from) / (width / 2)) : Infinity;
    const count = 2 ** Math.floor(Math.log2(Math.min(SPECTRUM_POINTS, Math.max(8, Math.min(least, (to - from) * 1000)))));
    const rate = count / (to - from);
    let hertz: number[] = [];
    const found = this.spec.curves.map((curve, i) => {
      const ring = window.ring(curve.stream);
      const column = this.store.column(curve.stream, curve.column);
      const [times, values] = samplesOf(ring, column, from, to);
      if (times.length < 16) return [];
      const spectrum = spectrumOf(resampled(times, values, from, to, count), rate);
      hertz = spectrum.hertz;
      return spectrum.amplitude.map((value) => Math.max(1e-12, value * this.drawn[i]!.scale));
    });
    if (!hertz.length) return;
    this.data = [hertz, ...found.map((values) => (values.length ? values : hertz.map(() => null)))] as uPlot.AlignedData;
    this.plot!.setData(this.data, false);
    this.plot!.setScale("x", { min: hertz[0]!, max: hertz.at(-1)! });
  }

  private listen(): void {
    const over = this.plot!.over;
    let isDown = false;
    const tell = (event: PointerEvent, begins: boolean): void => {
      if (this.spec.kind !== "time" || !this.window) return;
      const left = event.clientX - over.getBoundingClientRect().left;
      this.onTime(this.plot!.posToVal(left, "x") + this.window.zero, begins);
    };
    over.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      isDown = true;
      over.setPointerCapture(event.pointerId);
      tell(event, true);
    });
    over.addEventListener("pointermove", (event) => isDown && tell(event, false));
    for (const name of ["pointerup", "pointercancel"] as const) over.addEventListener(name, () => (isDown = false));
  }

  /** Write the values under the pointer, which all scopes share. */
  private readAt(plot: uPlot): void {
    const at = plot.cursor.idx;
    this.values.hidden = at === null || at === undefined || (plot.cursor.left ?? -1) < 0;
    if (this.values.hidden || at == null) {
      this.onHover(undefined);
      return;
    }
    const isSpectrum = this.spec.kind === "spectrum";
    const zero = this.window?.zero ?? 0;
    const reading = isSpectrum ? undefined : this.read(plot.posToVal(plot.cursor.left!, "x") + zero);
    const value = (i: number): number => {
      if (isSpectrum) return (this.data[i + 1] as ArrayLike<Point>)[at] ?? NaN;
      const { stream, column } = this.spec.curves[i]!;
      return (reading?.values.get(`${stream}.${column}`) ?? NaN) * this.drawn[i]!.scale;
    };
    if (!isSpectrum) this.onHover(plot.posToVal(plot.cursor.left!, "x") + zero);
    const shown = this.drawn.map(({ label, unit, colour: token, floor }, i) => {
      const number = Number.isNaN(value(i)) ? "–" : `${Math.abs(value(i)) < floor / 100 && !isSpectrum ? 0 : +value(i).toPrecision(4)}`;
      const text = make("span", {}, `${SHORT[label] ?? label} ${number}${unit ? ` ${unit}` : ""}`);
      text.style.color = `var(--${token})`;
      return text;
    });
    const where = isSpectrum ? `${+(plot.data[0][at] ?? 0).toPrecision(3)} Hz` : `${reading?.isExact ? "" : "≈ "}${fixed((reading?.time ?? NaN) - zero, 3)} s`;
    this.values.replaceChildren(make("span", {}, where), ...shown);
  }

  /** Lines for the playhead, the moments of a recording, and the two cursors. */
  private drawMarks(plot: uPlot): void {
    const window = this.window;
    if (!window || this.spec.kind !== "time") return;
    const { ctx: pen, bbox } = plot;
    const ratio = devicePixelRatio;
    const line = (time: number, style: string, width: number, dash: number[], text = ""): void => {
      const x = Math.round(plot.valToPos(time - window.zero, "x", true));
      if (!(x >= bbox.left && x <= bbox.left + bbox.width)) return;
      pen.strokeStyle = pen.fillStyle = style;
      pen.lineWidth = width * ratio;
      pen.setLineDash(dash.map((length) => length * ratio));
      pen.beginPath();
      pen.moveTo(x, bbox.top);
      pen.lineTo(x, bbox.top + bbox.height);
      pen.stroke();
      pen.setLineDash([]);
      if (text) {
        pen.font = `${11 * ratio}px system-ui`;
        pen.fillText(text, x + 3 * ratio, bbox.top + 10 * ratio);
      }
    };
    pen.save();
    this.drawAge(plot, window);
    for (const moment of window.moments) line(moment, colour("edge"), 1, [2, 3]);
    if (window.now !== undefined) line(window.now, colour("text"), 1.5, []);
    window.cursors?.forEach((time, i) => line(time, colour("text"), 1.5, [5, 3], "AB"[i]!));
    pen.restore();
  }

  /** Grey from the last sample on, with its age, where what is drawn ends before the present. */
  private drawAge(plot: uPlot, window: Window): void {
    const ends = this.spec.curves.map(({ stream }) => [window.ring(stream)?.newest ?? -Infinity, window.age(stream)] as const).filter(([newest, age]) => age > 0 && newest < window.to);
    if (!ends.length) return;
    const [newest, age] = ends.reduce((oldest, each) => (each[0] < oldest[0] ? each : oldest));
    const { ctx: pen, bbox } = plot;
    const ratio = devicePixelRatio;
    const from = Math.max(bbox.left, Math.min(bbox.left + bbox.width, plot.valToPos(newest - window.zero, "x", true)));
    pen.globalAlpha = 0.35;
    pen.fillStyle = colour("quiet");
    pen.fillRect(from, bbox.top, bbox.left + bbox.width - from, bbox.height);
    pen.globalAlpha = 1;
    pen.fillStyle = colour("text");
    pen.font = `${11 * ratio}px system-ui`;
    pen.textAlign = "right";
    pen.fillText(`${ageWords(age)} old`, bbox.left + bbox.width - 4 * ratio, bbox.top + bbox.height - 6 * ratio);
    pen.textAlign = "left";
  }

  private build(): uPlot {
    const axis = { stroke: colour("quiet"), grid: { stroke: colour("line"), width: 1 }, ticks: { show: false }, font: "11px system-ui" };
    const isSpectrum = this.spec.kind === "spectrum";
    const size = (_: uPlot, values: string[] | null): number => 12 + 6.4 * Math.max(1, ...(values ?? [""]).map((text) => text?.length ?? 0));
    // the unit stands in the axis, at its uppermost number
    // an axis that shows nothing but the floor around 0 has no other number: the rest of it would say how small nothing is
    const labels = (i: number) => (_: uPlot, splits: number[]): string[] => this.isNothing[i] ? splits.map((value) => (Math.abs(value) < 1e-12 ? `0 ${this.units[i]}` : "")) : tickTexts(splits).map((text, at) => (at === splits.length - 1 && this.units[i] ? `${text} ${this.units[i]}` : text));
    // powers of ten alone have a label where the axis is one of them
    const powers = (_: uPlot, splits: (number | null)[]): string[] => splits.map((value) => (value && Math.abs(Math.log10(value) % 1) < 1e-9 ? `${value}` : ""));
    // The height that the plot knows: to read that of an element makes the browser lay out the page in each frame.
    const splitsUpwards = (plot: uPlot, _: number, min: number, max: number): number[] => tickPlaces(min, max, Math.max(1, Math.floor(plot.bbox.height / devicePixelRatio / TICK_PX)));
    const side = (i: number): uPlot.Axis => ({ ...axis, scale: `y${i}`, side: i ? 1 : 3, size, ...(isSpectrum ? { space: 22 } : { splits: splitsUpwards }), ...(i ? { grid: { show: false } } : {}), values: isSpectrum ? powers : labels(i) });
    const scales = Object.fromEntries(this.axes.map((i) => [`y${i}`, isSpectrum ? { distr: 3 as const, log: 10 as const } : { range: (_: uPlot, min: number | null, max: number | null) => this.rangeOf(i, min, max) }]));
    return new uPlot(
      {
        width: Math.max(50, this.area.clientWidth),
        height: Math.max(50, this.area.clientHeight),
        padding: [8, this.axes.length > 1 ? 0 : MARGIN_PX, 0, 0],
        legend: { show: false },
        cursor: { sync: { key: isSpectrum ? "spectra" : "scopes" }, drag: { x: false, y: false } },
        hooks: { setCursor: [(plot: uPlot) => this.readAt(plot)], draw: [(plot: uPlot) => this.drawMarks(plot)] },
        scales: { x: isSpectrum ? { time: false, distr: 3, log: 10 } : { time: false }, ...scales },
        axes: [
          { ...axis, size: 20, space: 48, values: isSpectrum ? powers : secondsOf },
          ...this.axes.map(side),
        ],
        series: [{}, ...this.drawn.map(({ unit, colour: token, isDashed }) => ({ stroke: colour(token), ...(isDashed && { dash: DASHES }), width: 1.5, points: { show: false }, scale: `y${Math.max(0, Math.min(1, this.units.indexOf(unit)))}` }))],
      },
      this.data,
      this.area,
    );
  }

  /** Numbers of the axes: one for each unit, of which there are two at most. */
  private get axes(): number[] {
    return this.units.slice(0, 2).map((_, i) => i);
  }

  private rangeOf(axis: number, min: number | null, max: number | null): [number, number] {
    if (this.spec.range && axis === 0) return this.spec.range;
    const own = this.drawn.flatMap(({ unit }, i) => (this.units.indexOf(unit) === axis ? [i] : []));
    const floor = Math.max(...own.map((i) => this.drawn[i]!.floor));
    const noise = Math.max(...own.map((i) => noiseOf(this.data[i + 1] ?? [])));
    const counting = own.flatMap((i) => this.extents[i] ?? []);
    const [least, greatest] = counting.length ? [Math.min(...counting), Math.max(...counting)] : [min, max];
    this.isNothing[axis] = isNothing(least, greatest, floor);
    const found = axisRange(least, greatest, floor, noise);
    // no share, age or delay is negative, and an axis that goes there looks as if one were
    if (["ms", "%"].includes(this.units[axis]!) && (least ?? 0) >= 0) found[0] = Math.max(0, found[0]);
    // where somebody moves a playhead, what is seen changes because they want it
    const waits = this.window?.now === undefined ? undefined : 0;
    return (this.axesHeld[axis] = heldAxis(this.axesHeld[axis], found, performance.now(), waits)).range;
  }
}

/** The names of the columns of each stream. */
export function columnsOf(store: Store): Map<string, string[]> {
  return new Map([...store.streams.values()].map(({ name, columns }) => [name, columns.map((column) => column.name)]));
}

/** Texts of an axis of time, of which the last has the unit. */
function secondsOf(_: uPlot, splits: number[]): string[] {
  return tickTexts(splits).map((text, i) => (i === splits.length - 1 ? `${text} s` : text));
}
