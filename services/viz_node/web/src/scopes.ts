import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import { colour, make, save } from "./dom";
import { Pace } from "./pace";
import { Playhead } from "./playhead";
import { grid, minMax, type Point } from "./ring";
import type { Store } from "./store";
import { ticks, tickText } from "./ticks";

interface Curve {
  stream: string;
  column: string;
  label: string;
  colour: string;
  scale: number;
  /** Drawn against the axis on the right. */
  right?: boolean;
}

interface ScopeAbout {
  name: string;
  unit: string;
  /** Unit of the axis on the right. */
  right?: string;
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
    name: "Loop age, link delay",
    unit: "ms",
    right: "loss, %",
    curves: [
      curve("hand", "loop_age", "loop age", "c1", 1e3),
      curve("link", "forward_delay", "link →", "c2", 1e3),
      curve("link", "backward_delay", "link ←", "c3", 1e3),
      { ...curve("link", "forward_loss", "loss →", "c4", 1e2), right: true },
      { ...curve("link", "backward_loss", "loss ←", "bad", 1e2), right: true },
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
/** Where frames are slow the curves are drawn in every second one, so that the page still answers. */
const SLOW_SHARE = 2;
const SPANS = [0.5, 1, 2, 5, 10, 30, 60];

class Scope {
  readonly area = make("div", { class: "area" });
  readonly element: HTMLElement;
  /** Whether it is in the part of the page that is seen: what is not seen is not drawn. */
  isSeen = true;
  private plot: uPlot;
  private data: uPlot.AlignedData = [[]];
  private readonly values = make("div", { class: "at-cursor", hidden: true });

  constructor(
    readonly about: ScopeAbout,
    private readonly store: Store,
  ) {
    const keys = about.curves.map((c) => {
      const key = make("span", { class: "key" }, c.label);
      key.style.setProperty("--key", `var(--${c.colour})`);
      return key;
    });
    const title = titleOf(about);
    this.element = make("div", { class: "plot", role: "img", "aria-label": `${title} over time` });
    this.element.append(make("div", { class: "name" }, title, ...keys), this.area);
    this.area.append(this.values);
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

  /** Write the values under the cursor, which all scopes share. */
  private readAt(plot: uPlot): void {
    const at = plot.cursor.idx;
    this.values.hidden = at === null || at === undefined || (plot.cursor.left ?? -1) < 0;
    if (this.values.hidden || at == null) return;
    const value = (points: ArrayLike<Point>): string => {
      const known = [0, 1, -1, 2, -2].map((step) => points[at + step]).find((point) => typeof point === "number");
      return known === undefined ? "–" : `${+known.toPrecision(4)}`;
    };
    const shown = this.about.curves.map((c, i) => {
      const text = make("span", {}, value(this.data[i + 1] as ArrayLike<Point>));
      text.style.color = `var(--${c.colour})`;
      return text;
    });
    this.values.replaceChildren(make("span", {}, `${(plot.data[0][at] ?? 0).toFixed(3)} s`), ...shown);
  }

  private build(): uPlot {
    const axis = { stroke: colour("quiet"), grid: { stroke: colour("line"), width: 1 }, ticks: { show: false }, font: "11px system-ui" };
    return new uPlot(
      {
        width: Math.max(50, this.area.clientWidth),
        height: Math.max(50, this.area.clientHeight),
        legend: { show: false },
        cursor: { sync: { key: "scopes" }, drag: { x: false, y: false } },
        hooks: { setCursor: [(plot: uPlot) => this.readAt(plot)] },
        scales: { x: { time: false }, y: { range: (_, min, max) => padded(min, max) }, ...(this.about.right && { right: { range: (_: uPlot, __: number, max: number): [number, number] => [0, Math.max(1, max || 0) * 1.06] } }) },
        axes: [
          { ...axis, size: 22, values: (_, splits) => splits.map((value) => `${+value.toPrecision(3)} s`) },
          { ...axis, size: 46, values: (_, splits) => splits.map((value) => tickText(value, 4)) },
          ...(this.about.right ? [{ ...axis, scale: "right", side: 1 as const, size: 26, grid: { show: false }, values: (_: uPlot, splits: number[]) => splits.map((value) => `${+value.toPrecision(3)}`) }] : []),
        ],
        series: [{}, ...this.about.curves.map((c) => ({ stroke: colour(c.colour), width: 1.25, points: { show: false }, scale: c.right ? "right" : "y" }))],
      },
      this.data,
      this.area,
    );
  }
}

function titleOf(about: ScopeAbout): string {
  return `${about.name}, ${about.unit}${about.right ? `; ${about.right}` : ""}`;
}

function padded(min: number | null, max: number | null): [number, number] {
  if (min === null || max === null || !Number.isFinite(min) || !Number.isFinite(max)) return [-1, 1];
  const margin = (max - min) * 0.06 || Math.abs(max) * 0.1 || 1e-3;
  return [min - margin, max + margin];
}

/** Force against distance: the approach and the withdrawal differ by the meniscus. */
class ForceDistance {
  isSeen = true;
  readonly canvas = make("canvas");
  private readonly values = make("div", { class: "at-cursor", hidden: true });
  readonly area = make("div", { class: "area" }, this.canvas, this.values);
  /** What is at a place of the canvas: distance [nm] and force [nN]. */
  private readAt: ((x: number, y: number) => [number, number]) | undefined;
  readonly element = make("div", { class: "plot", role: "img", "aria-label": "Force on the tip in nN against distance in nm" });

  constructor(private readonly store: Store) {
    const name = make("div", { class: "name" }, "Force against distance, nN over nm", key("towards", "c1"), key("away", "c2"));
    this.element.append(name, this.area);
    this.canvas.addEventListener("pointermove", (event) => {
      const [distance, force] = this.readAt?.(event.offsetX, event.offsetY) ?? [NaN, NaN];
      this.values.hidden = Number.isNaN(force);
      this.values.textContent = `${+distance.toPrecision(4)} nm, ${+force.toPrecision(4)} nN`;
    });
    this.canvas.addEventListener("pointerleave", () => (this.values.hidden = true));
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
    this.readAt = (x, y) => [x0 + ((x - left) / (width - left - 6)) * (x1 - x0), y0 + ((bottom - y) / (bottom - 4)) * (y1 - y0)];
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
  private readonly playhead = new Playhead();
  private readonly pace = new Pace(SLOW_SHARE);
  private drawnTo = NaN;

  constructor(
    root: HTMLElement,
    private readonly store: Store,
  ) {
    const select = make(
      "select",
      { id: "span", "aria-label": "Span of the scopes", onchange: () => this.setSpan(Number(select.value)) },
      ...SPANS.map((span) => make("option", { value: span, selected: span === this.span }, `${span} s`)),
    );
    this.pauseButton = make("button", { type: "button", id: "pause", "aria-pressed": "false", onclick: () => this.pause() }, "Pause");
    const toolbar = make("div", { class: "toolbar" }, make("h2", {}, "Scopes"), make("span", { class: "spacer" }), "Span", select, this.pauseButton);
    toolbar.append(
      make("button", { type: "button", id: "save-png", onclick: () => this.savePicture() }, "Save PNG"),
      make("button", { type: "button", id: "save-csv", onclick: () => save("telenano-scopes.csv", new Blob([this.csv()], { type: "text/csv" })) }, "Save CSV"),
    );
    const plots = make("div", { class: "plots" });
    root.append(toolbar, plots);
    this.scopes = SCOPES.map((about) => new Scope(about, store));
    this.distance = new ForceDistance(store);
    const elements = this.scopes.map((scope) => scope.element);
    plots.append(...elements.slice(0, 3), this.distance.element, ...elements.slice(3));
    new ResizeObserver(() => {
      this.scopes.forEach((scope) => scope.resize());
      this.invalidate();
    }).observe(plots);
    const seen = new IntersectionObserver((entries) => {
      for (const entry of entries) {
        const scope = [...this.scopes, this.distance].find((found) => found.element === entry.target);
        if (scope) scope.isSeen = entry.isIntersecting;
      }
      this.invalidate();
    });
    for (const scope of [...this.scopes, this.distance]) seen.observe(scope.element);
  }

  /** Draw with the next frame, also what does not move. */
  invalidate(): void {
    this.drawnTo = NaN;
  }

  private setSpan(span: number): void {
    this.span = span;
    this.invalidate();
  }

  pause(): void {
    this.pausedAt = this.pausedAt === undefined ? this.playhead.at : undefined;
    this.pauseButton.setAttribute("aria-pressed", String(this.pausedAt !== undefined));
    this.pauseButton.textContent = this.pausedAt === undefined ? "Pause" : "Go on";
  }

  /** Draw the curves up to the time of a frame [ms], unless nothing has changed since the last. */
  draw(now: number): void {
    const { source } = this.store;
    const rate = source.kind === "live" ? 1 : source.playing ? (source.rate ?? 1) : 0;
    const head = this.playhead.advance(this.store.newest, now, rate);
    const to = this.pausedAt ?? head;
    if (!this.pace.isDue(now) || !Number.isFinite(to) || to === this.drawnTo) return;
    this.pace.drawn(now);
    this.drawnTo = to;
    for (const scope of [...this.scopes, this.distance]) if (scope.isSeen) scope.draw(to - this.span, to);
  }

  recolour(): void {
    this.scopes.forEach((scope) => scope.recolour());
    this.invalidate();
  }

  /** Every sample of the span that is shown, in SI units: when the times begin, then a block of lines for each stream. */
  csv(): string {
    const to = this.pausedAt ?? this.playhead.at;
    const lines = ["stream,time_s,column,value,unit", `session,0.000000,t_ns,${this.store.originNs},ns`];
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
    const names = [...this.scopes.map((s) => titleOf(s.about)), "Force against distance, nN over nm"];
    pictures.forEach((picture, i) => {
      const [x, y] = [(i % 2) * width, Math.floor(i / 2) * height];
      pen.fillStyle = colour("text");
      pen.fillText(names[i]!, x + 8, y + 17);
      pen.drawImage(picture, x, y + 24);
    });
    sheet.toBlob((blob) => blob && save("telenano-scopes.png", blob));
  }
}
