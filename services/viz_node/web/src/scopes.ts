import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { colour, make, save } from "./dom";
import { grid, minMax, type Point } from "./ring";
import type { Store } from "./store";

interface Curve {
  stream: string;
  column: string;
  label: string;
  colour: string;
  scale: number;
}

interface ScopeAbout {
  name: string;
  unit: string;
  curves: Curve[];
}

const curve = (stream: string, column: string, label: string, key: string, scale = 1): Curve => ({
  stream,
  column,
  label,
  colour: key,
  scale,
});

export const SCOPES: ScopeAbout[] = [
  {
    name: "Force at the hand",
    unit: "N",
    curves: [curve("hand", "force", "hand F_m", "c1"), curve("command", "tip_force", "tip α_f F_s", "c2")],
  },
  {
    name: "Hand",
    unit: "mm",
    curves: [curve("hand", "position", "position", "c1", 1e3), curve("hand", "reference", "reference", "c2", 1e3)],
  },
  {
    name: "Force on the tip",
    unit: "nN",
    curves: [
      curve("tip", "force", "normal", "c1", 1e9),
      curve("tip", "force_x", "lateral x", "c3", 1e9),
      curve("tip", "force_y", "lateral y", "c4", 1e9),
    ],
  },
  {
    name: "Loop age and link delay",
    unit: "ms",
    curves: [
      curve("hand", "loop_age", "loop age", "c1", 1e3),
      curve("link", "forward_delay", "link →", "c2", 1e3),
      curve("link", "backward_delay", "link ←", "c3", 1e3),
    ],
  },
  {
    name: "Energy of the ports",
    unit: "mJ",
    curves: [
      curve("law_master", "port_energy", "master", "c1", 1e3),
      curve("law_slave", "port_energy", "slave", "c2", 1e3),
      curve("law_master", "net_energy", "net", "c3", 1e3),
    ],
  },
];

/** Without samples for this long a curve is broken [s]. */
const GAPS: Record<string, number> = { link: 0.6, law_master: 0.2, law_slave: 0.2 };
const GAP = 0.06;
const SPANS = [0.5, 1, 2, 5, 10, 30, 60];

class Scope {
  readonly area = make("div", { class: "area" });
  readonly element: HTMLElement;
  private plot: uPlot;
  private data: uPlot.AlignedData = [[]];

  constructor(
    readonly about: ScopeAbout,
    private readonly store: Store,
  ) {
    const keys = about.curves.map((c) => {
      const key = make("span", { class: "key" }, c.label);
      key.style.setProperty("--key", `var(--${c.colour})`);
      return key;
    });
    this.element = make("div", { class: "plot", role: "img", "aria-label": `${about.name} in ${about.unit} over time` });
    this.element.append(make("div", { class: "name" }, `${about.name}, ${about.unit}`, ...keys), this.area);
    this.plot = this.build();
  }

  /** Draw the curves between two times [s]. */
  draw(from: number, to: number): void {
    const buckets = Math.max(50, Math.min(600, Math.round(this.area.clientWidth / 2)));
    const times = Array.from(grid(from, to, buckets), (time) => time - to);
    const series = this.about.curves.map((c): Point[] => {
      const ring = this.store.rings.get(c.stream);
      const column = this.store.column(c.stream, c.column);
      if (!ring || column < 0) return new Array<Point>(2 * buckets).fill(null);
      const points = minMax(ring, column, from, to, buckets, GAPS[c.stream] ?? GAP);
      return points.map((value) => (value == null ? value : value * c.scale));
    });
    this.data = [times, ...series] as uPlot.AlignedData;
    this.plot.setData(this.data, false);
    this.plot.setScale("x", { min: from - to, max: 0 });
  }

  resize(): void {
    const { clientWidth: width, clientHeight: height } = this.area;
    if (width > 0 && height > 0 && (width !== this.plot.width || height !== this.plot.height)) {
      this.plot.setSize({ width, height });
    }
  }

  /** Build the plot again in the colours of the theme. */
  recolour(): void {
    this.plot.destroy();
    this.plot = this.build();
    this.plot.setData(this.data);
  }

  picture(): HTMLCanvasElement {
    return this.plot.ctx.canvas;
  }

  private build(): uPlot {
    const axis = { stroke: colour("quiet"), grid: { stroke: colour("line"), width: 1 }, ticks: { show: false }, font: "11px system-ui" };
    return new uPlot(
      {
        width: Math.max(50, this.area.clientWidth),
        height: Math.max(50, this.area.clientHeight),
        legend: { show: false },
        cursor: { sync: { key: "scopes" }, drag: { x: false, y: false } },
        scales: { x: { time: false }, y: { range: (_, min, max) => padded(min, max) } },
        axes: [
          { ...axis, size: 22, values: (_, splits) => splits.map((value) => `${+value.toPrecision(3)} s`) },
          { ...axis, size: 46, values: (_, splits) => splits.map((value) => `${+value.toPrecision(4)}`) },
        ],
        series: [{}, ...this.about.curves.map((c) => ({ stroke: colour(c.colour), width: 1.25, points: { show: false } }))],
      },
      this.data,
      this.area,
    );
  }
}

function padded(min: number | null, max: number | null): [number, number] {
  if (min === null || max === null || !Number.isFinite(min) || !Number.isFinite(max)) return [-1, 1];
  const margin = (max - min) * 0.06 || Math.abs(max) * 0.1 || 1e-3;
  return [min - margin, max + margin];
}

/** Force against distance: the approach and the withdrawal differ by the meniscus. */
class ForceDistance {
  readonly canvas = make("canvas");
  readonly area = make("div", { class: "area" }, this.canvas);
  readonly element = make("div", { class: "plot", role: "img", "aria-label": "Force on the tip in nN against distance in nm" });

  constructor(private readonly store: Store) {
    const name = make("div", { class: "name" }, "Force against distance, nN over nm", key("towards", "c1"), key("away", "c2"));
    this.element.append(name, this.area);
  }

  draw(from: number, to: number): void {
    const { clientWidth: width, clientHeight: height } = this.area;
    const ratio = devicePixelRatio;
    if (this.canvas.width !== width * ratio || this.canvas.height !== height * ratio) {
      this.canvas.width = width * ratio;
      this.canvas.height = height * ratio;
      this.canvas.style.width = `${width}px`;
      this.canvas.style.height = `${height}px`;
    }
    const pen = this.canvas.getContext("2d")!;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    const points = this.points(from, to);
    if (points.length < 2) return;
    let [x0, x1, y0, y1] = [Infinity, -Infinity, Infinity, -Infinity];
    for (const [x, y] of points) {
      [x0, x1] = [Math.min(x0, x), Math.max(x1, x)];
      [y0, y1] = [Math.min(y0, y), Math.max(y1, y)];
    }
    [x0, x1] = padded(x0, x1);
    [y0, y1] = padded(y0, y1);
    const left = 42;
    const bottom = height - 20;
    const toX = (x: number): number => left + ((x - x0) / (x1 - x0)) * (width - left - 6);
    const toY = (y: number): number => bottom - ((y - y0) / (y1 - y0)) * (bottom - 4);
    pen.font = "11px system-ui";
    pen.lineWidth = 1;
    for (const [at, text] of ticks(x0, x1)) line(pen, toX(at), 4, toX(at), bottom, text, "center", toX(at), height - 6);
    for (const [at, text] of ticks(y0, y1)) line(pen, left, toY(at), width - 6, toY(at), text, "right", left - 4, toY(at) + 4);
    pen.lineWidth = 1.25;
    for (const towards of [false, true]) {
      pen.strokeStyle = colour(towards ? "c1" : "c2");
      pen.beginPath();
      for (let i = 1; i < points.length; i++) {
        const [a, b] = [points[i - 1]!, points[i]!];
        if (b[0] < a[0] !== towards) continue;
        pen.moveTo(toX(a[0]), toY(a[1]));
        pen.lineTo(toX(b[0]), toY(b[1]));
      }
      pen.stroke();
    }
    const [x, y] = points.at(-1)!;
    pen.fillStyle = colour("text");
    pen.beginPath();
    pen.arc(toX(x), toY(y), 3.5, 0, 7);
    pen.fill();
  }

  private points(from: number, to: number): [number, number][] {
    const ring = this.store.rings.get("tip");
    if (!ring) return [];
    const force = this.store.column("tip", "force");
    const distance = this.store.column("tip", "separation");
    const [first, end] = [ring.indexAt(from), ring.indexAt(to + 1e-9)];
    // what moves less than a pixel adds nothing; every sample that stands out is kept by the greatest change
    const step = Math.max(1, Math.floor((end - first) / 4000));
    const found: [number, number][] = [];
    for (let i = first; i < end; i += step) {
      let chosen = i;
      for (let j = i; j < Math.min(end, i + step); j++) {
        if (Math.abs(ring.value(force, j)) > Math.abs(ring.value(force, chosen))) chosen = j;
      }
      const [x, y] = [ring.value(distance, chosen) * 1e9, ring.value(force, chosen) * 1e9];
      if (!Number.isNaN(x) && !Number.isNaN(y)) found.push([x, y]);
    }
    return found;
  }
}

function key(text: string, name: string): HTMLElement {
  const found = make("span", { class: "key" }, text);
  found.style.setProperty("--key", `var(--${name})`);
  return found;
}

function ticks(min: number, max: number): [number, string][] {
  const rough = (max - min) / 4;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((candidate) => candidate >= rough) ?? rough;
  const found: [number, string][] = [];
  for (let at = Math.ceil(min / step) * step; at <= max; at += step) found.push([at, `${+at.toPrecision(3)}`]);
  return found;
}

function line(
  pen: CanvasRenderingContext2D,
  x0: number,
  y0: number,
  x1: number,
  y1: number,
  text: string,
  align: CanvasTextAlign,
  textX: number,
  textY: number,
): void {
  pen.strokeStyle = colour("line");
  pen.beginPath();
  pen.moveTo(x0, y0);
  pen.lineTo(x1, y1);
  pen.stroke();
  pen.fillStyle = colour("quiet");
  pen.textAlign = align;
  pen.fillText(text, textX, textY);
}

/** The scopes with their toolbar: span, pause, save. */
export class Scopes {
  private readonly scopes: Scope[];
  private readonly distance: ForceDistance;
  private readonly pauseButton: HTMLButtonElement;
  private span = 10;
  private pausedAt: number | undefined;

  constructor(
    root: HTMLElement,
    private readonly store: Store,
  ) {
    const select = make(
      "select",
      { id: "span", "aria-label": "Span of the scopes", onchange: () => (this.span = Number(select.value)) },
      ...SPANS.map((span) => make("option", { value: span, selected: span === this.span }, `${span} s`)),
    );
    this.pauseButton = make("button", { type: "button", id: "pause", "aria-pressed": "false", onclick: () => this.pause() }, "Pause");
    const toolbar = make("div", { class: "toolbar" }, make("h2", {}, "Scopes"), make("span", { class: "spacer" }), "Span", select, this.pauseButton);
    toolbar.append(
      make("button", { type: "button", onclick: () => this.savePicture() }, "Save PNG"),
      make("button", { type: "button", id: "save-csv", onclick: () => save("telenano-scopes.csv", new Blob([this.csv()], { type: "text/csv" })) }, "Save CSV"),
    );
    const plots = make("div", { class: "plots" });
    root.append(toolbar, plots);
    this.scopes = SCOPES.map((about) => new Scope(about, store));
    this.distance = new ForceDistance(store);
    const elements = this.scopes.map((scope) => scope.element);
    plots.append(...elements.slice(0, 3), this.distance.element, ...elements.slice(3));
    new ResizeObserver(() => this.scopes.forEach((scope) => scope.resize())).observe(plots);
  }

  pause(): void {
    this.pausedAt = this.pausedAt === undefined ? this.store.newest : undefined;
    this.pauseButton.setAttribute("aria-pressed", String(this.pausedAt !== undefined));
    this.pauseButton.textContent = this.pausedAt === undefined ? "Pause" : "Go on";
  }

  draw(): void {
    const to = this.pausedAt ?? this.store.newest;
    if (!Number.isFinite(to)) return;
    for (const scope of this.scopes) scope.draw(to - this.span, to);
    this.distance.draw(to - this.span, to);
  }

  recolour(): void {
    this.scopes.forEach((scope) => scope.recolour());
  }

  /** Every sample of the span that is shown, in SI units: a block of lines for each stream. */
  csv(): string {
    const to = this.pausedAt ?? this.store.newest;
    const lines = ["stream,time_s,column,value,unit"];
    for (const [name, ring] of this.store.rings) {
      const columns = this.store.streams.get(name)?.columns ?? [];
      for (let i = ring.indexAt(to - this.span); i < ring.length && ring.time(i) <= to; i++) {
        columns.forEach((column, c) => {
          const value = ring.value(c, i);
          if (!Number.isNaN(value)) lines.push(`${name},${ring.time(i).toFixed(6)},${column.name},${value},${column.unit}`);
        });
      }
    }
    return `${lines.join("\n")}\n`;
  }

  private savePicture(): void {
    const pictures = [...this.scopes.map((scope) => scope.picture()), this.distance.canvas];
    const [width, height] = [Math.max(...pictures.map((p) => p.width)), Math.max(...pictures.map((p) => p.height)) + 24];
    const sheet = make("canvas", { width: 2 * width, height: 3 * height });
    const pen = sheet.getContext("2d")!;
    pen.fillStyle = colour("panel");
    pen.fillRect(0, 0, sheet.width, sheet.height);
    pen.font = "15px system-ui";
    const names = [...this.scopes.map((s) => `${s.about.name}, ${s.about.unit}`), "Force against distance, nN over nm"];
    pictures.forEach((picture, i) => {
      const [x, y] = [(i % 2) * width, Math.floor(i / 2) * height];
      pen.fillStyle = colour("text");
      pen.fillText(names[i]!, x + 8, y + 17);
      pen.drawImage(picture, x, y + 24);
    });
    sheet.toBlob((blob) => blob && save("telenano-scopes.png", blob));
  }
}
