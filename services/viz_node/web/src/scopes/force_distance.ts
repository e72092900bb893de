import { colour, make } from "../dom";
import type { Ring } from "../ring";
import type { Store } from "../store";
import { TICK_PX, ticks } from "../ticks";
import { axisRange, heldAxis, type HeldAxis } from "./range";

/** What is less than this is noise of the read-out: in nm and in nN. */
const FLOOR_NM = 1;
const FLOOR_NN = 0.5;
/** Samples that stand for longer than this do not belong to each other any more [s]. */
const MOST_WIDTH_S = 0.05;

/** Force against distance: the approach and the withdrawal differ by the meniscus. */
export class ForceDistance {
  readonly canvas = make("canvas");
  private readonly values = make("div", { class: "at-cursor", hidden: true });
  readonly area = make("div", { class: "area" }, this.canvas, this.values);
  /** What is at a place of the canvas: distance [nm] and force [nN]. */
  private readAt: ((x: number, y: number) => [number, number]) | undefined;
  private across: HeldAxis | undefined;
  private up: HeldAxis | undefined;

  constructor(private readonly store: Store) {
    this.canvas.addEventListener("pointermove", (event) => {
      const [distance, force] = this.readAt?.(event.offsetX, event.offsetY) ?? [NaN, NaN];
      this.show(distance, force);
    });
    this.canvas.addEventListener("pointerleave", () => (this.values.hidden = true));
  }

  /** Show a distance [nm] and a force [nN] as numbers; nothing where they are not known. */
  show(distance: number, force: number): void {
    this.values.hidden = Number.isNaN(force) || Number.isNaN(distance);
    this.values.textContent = `${+distance.toPrecision(4)} nm, ${+force.toPrecision(4)} nN`;
  }

  /** Draw the samples of a ring from one time to another [s]; `width` is the time that two of them stand for. */
  draw(ring: Ring | undefined, from: number, to: number, width: number, now: number): void {
    const { clientWidth: across, clientHeight: height } = this.area;
    const ratio = devicePixelRatio;
    if (this.canvas.width !== across * ratio || this.canvas.height !== height * ratio) {
      this.canvas.width = across * ratio;
      this.canvas.height = height * ratio;
      this.canvas.style.width = `${across}px`;
      this.canvas.style.height = `${height}px`;
    }
    const pen = this.canvas.getContext("2d")!;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, across, height);
    const points = ring && width <= MOST_WIDTH_S ? this.points(ring, from, to, width) : [];
    if (points.length < 2) {
      pen.font = "11px system-ui";
      pen.fillStyle = colour("quiet");
      if (width > MOST_WIDTH_S) pen.fillText("a shorter span shows it", 10, height / 2);
      return;
    }
    let [x0, x1, y0, y1] = [Infinity, -Infinity, Infinity, -Infinity];
    for (const [x, y] of points) {
      [x0, x1] = [Math.min(x0, x), Math.max(x1, x)];
      [y0, y1] = [Math.min(y0, y), Math.max(y1, y)];
    }
    const wall = performance.now();
    const waits = now < to ? 0 : undefined;
    this.across = heldAxis(this.across, axisRange(x0, x1, FLOOR_NM), wall, waits);
    this.up = heldAxis(this.up, axisRange(y0, y1, FLOOR_NN), wall, waits);
    [x0, x1] = this.across.range;
    [y0, y1] = this.up.range;
    pen.font = "11px system-ui";
    const bottom = height - 20;
    const upwards = Math.max(1, Math.floor((bottom - 4) / TICK_PX));
    // the widest label has room, whatever it is
    const left = 10 + Math.max(...ticks(y0, y1, upwards).map(([, text]) => pen.measureText(`${text} nN`).width));
    const toX = (x: number): number => left + ((x - x0) / (x1 - x0)) * (across - left - 6);
    const toY = (y: number): number => bottom - ((y - y0) / (y1 - y0)) * (bottom - 4);
    this.readAt = (x, y) => [x0 + ((x - left) / (across - left - 6)) * (x1 - x0), y0 + ((bottom - y) / (bottom - 4)) * (y1 - y0)];
    pen.font = "11px system-ui";
    pen.lineWidth = 1;
    for (const [at, text] of withUnit(ticks(x0, x1), "nm")) line(pen, toX(at), 4, toX(at), bottom, text, "center", Math.min(toX(at), across - pen.measureText(text).width / 2 - 2), height - 6);
    for (const [at, text] of withUnit(ticks(y0, y1, upwards), "nN")) line(pen, left, toY(at), across - 6, toY(at), text, "right", left - 4, toY(at) + 4);
    pen.lineWidth = 1.5;
    for (const towards of [false, true]) {
      pen.strokeStyle = colour(towards ? "tip" : "quiet");
      pen.beginPath();
      for (let i = 1; i < points.length; i++) {
        const [a, b] = [points[i - 1]!, points[i]!];
        if (b[0] < a[0] !== towards) continue;
        pen.moveTo(toX(a[0]), toY(a[1]));
        pen.lineTo(toX(b[0]), toY(b[1]));
      }
      pen.stroke();
    }
    const [x, y] = points.findLast(([, , time]) => time <= now) ?? points.at(-1)!;
    pen.fillStyle = colour("text");
    pen.beginPath();
    pen.arc(toX(x), toY(y), 3.5, 0, 7);
    pen.fill();
  }

  private points(ring: Ring, from: number, to: number, width: number): [number, number, number][] {
    const force = this.store.column("tip", "force");
    const distance = this.store.column("tip", "separation");
    const follows = this.store.column("tip", "follows");
    // how the tip is placed and withdrawn is no touch
    const counts = (i: number): boolean => follows < 0 || ring.value(follows, i) >= 0.5;
    const [first, end] = [ring.indexAt(from), ring.indexAt(to + 1e-9)];
    const found: [number, number, number][] = [];
    const take = (x: number, y: number, time: number): void => {
      if (!Number.isNaN(x) && !Number.isNaN(y)) found.push([x * 1e9, y * 1e9, time]);
    };
    if (width > 0) {
      // least and greatest values of a span do not belong to each other: their middles do, to half of what changed in it
      const middle = (column: number, i: number): number => (ring.value(column, i) + ring.value(column, i + 1)) / 2;
      for (let i = first + (first & 1); i + 1 < end; i += 2) if (counts(i) && counts(i + 1)) take(middle(distance, i), middle(force, i), ring.time(i));
      return found;
    }
    // what moves less than a pixel adds nothing; every sample that stands out is kept by the greatest change
    const step = Math.max(1, Math.floor((end - first) / 4000));
    for (let i = first; i < end; i += step) {
      let chosen = i;
      for (let j = i; j < Math.min(end, i + step); j++) {
        if (Math.abs(ring.value(force, j)) > Math.abs(ring.value(force, chosen))) chosen = j;
      }
      if (counts(chosen)) take(ring.value(distance, chosen), ring.value(force, chosen), ring.time(chosen));
    }
    return found;
  }
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

/** Places and texts of ticks of which the last one has the unit. */
function withUnit(found: readonly [number, string][], unit: string): [number, string][] {
  return found.map(([at, text], i) => [at, i === found.length - 1 ? `${text} ${unit}` : text]);
}
