import { colour, make } from "../../kit.js";
import { targetAt } from "./cue.js";

/** What is seen of the past [s], and how often it is noted [s]. */
const SEEN_S = 6;
const NOTED_S = 0.02;
const UNITS = { force: [1e9, "nN", "force"], position: [1e9, "nm", "base"], place: [1e9, "nm", "x"], none: [1, "", ""] };

/** The target and what follows it: their course over the last seconds up to now, or from above for a place. */
export class TargetView {
  store;
  canvas = make("canvas", { role: "img", "aria-label": "Target, and what follows it" });
  now = make("b", { id: "now" }, "–");
  aim = make("span", { id: "aim", class: "quiet" });
  cue;
  course;
  trace = [];

  constructor(root, store) {
    this.store = store;
    root.append(make("div", { class: "big" }, this.now, this.aim), this.canvas);
  }

  begin(cue, course) {
    this.cue = cue;
    this.course = course;
    this.trace = [];
  }

  /** Draw at a time of the trial [s]. */
  draw(time) {
    const { cue } = this;
    if (!cue || !this.canvas.clientHeight) return;
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const ratio = Math.min(2, devicePixelRatio);
    if (this.canvas.width !== Math.round(width * ratio) || this.canvas.height !== Math.round(height * ratio)) {
      Object.assign(this.canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
    }
    const pen = this.canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    pen.font = "12px system-ui";
    if (cue.quantity === "place") this.place(pen, width, height);
    else this.curve(pen, width, height, time);
  }

  curve(pen, width, height, time) {
    const { cue, course } = this;
    const [factor, unit, column] = UNITS[cue.quantity === "none" ? "force" : cue.quantity];
    const value = this.store.last("tip", column);
    const last = this.trace.at(-1);
    if (!Number.isNaN(value) && (!last || time - last.at >= NOTED_S)) this.trace.push({ at: time, value });
    while (this.trace.length && this.trace[0].at < time - SEEN_S) this.trace.shift();
    this.write(`${Number.isNaN(value) ? "–" : Math.abs(factor * value) < 0.05 ? "0.0" : (factor * value).toFixed(1)} ${unit}`, course ? `target ${(factor * targetAt(course, time)).toFixed(1)} ${unit}` : "");
    const [low, high] = range(course, cue.band);
    const x = (at) => width * (0.92 + (0.92 * (at - time)) / SEEN_S);
    const y = (of) => height * (0.94 - (0.88 * (Math.min(high, Math.max(low, of)) - low)) / (high - low));
    pen.fillStyle = pen.strokeStyle = colour("line");
    for (const of of linesIn(low, high)) {
      pen.fillStyle = colour("line");
      pen.fillRect(0, y(of), width, 1);
      pen.fillStyle = colour("quiet");
      pen.fillText(`${(factor * of).toFixed(0)} ${unit}`, 4, y(of) - 3);
    }
    if (course) this.target(pen, course, cue.band, time, x, y);
    pen.strokeStyle = colour("c2");
    pen.lineWidth = 2.5;
    pen.beginPath();
    for (const { at, value: of } of this.trace) pen.lineTo(x(at), y(of));
    pen.stroke();
    if (!Number.isNaN(value)) disc(pen, x(time), y(value), 8, colour("c2"), true);
  }

  target(pen, course, band, time, x, y) {
    const steps = 120;
    const ats = Array.from({ length: steps + 1 }, (_, i) => Math.max(0, time - SEEN_S + (SEEN_S * i) / steps));
    pen.fillStyle = colour("good-back");
    pen.beginPath();
    for (const at of ats) pen.lineTo(x(at), y(targetAt(course, at) + band));
    for (const at of ats.toReversed()) pen.lineTo(x(at), y(targetAt(course, at) - band));
    pen.fill();
    pen.strokeStyle = colour("good");
    pen.lineWidth = 2;
    pen.beginPath();
    for (const at of ats) pen.lineTo(x(at), y(targetAt(course, at)));
    pen.stroke();
    disc(pen, x(time), y(targetAt(course, time)), 12, colour("good"), false);
  }

  place(pen, width, height) {
    const [tipX, tipY] = [this.store.last("tip", "x"), this.store.last("tip", "y")];
    const [goalX, goalY] = this.course ? [targetAt(this.course, 0, 0), targetAt(this.course, 0, 1)] : [0, 0];
    const half = 1.6 * Math.max(Math.hypot(goalX, goalY), 2 * this.cue.band, 1e-8);
    const scale = Math.min(width, height) / (2 * half);
    const x = (m) => width / 2 + m * scale;
    const y = (m) => height / 2 - m * scale;
    this.write(`${(1e9 * Math.hypot(tipX - goalX, tipY - goalY)).toFixed(0)} nm`, "from the tip to the target");
    disc(pen, x(goalX), y(goalY), Math.max(6, this.cue.band * scale), colour("good"), false);
    if (!Number.isNaN(tipX)) disc(pen, x(tipX), y(tipY), 6, colour("c2"), true);
  }

  write(now, aim) {
    if (this.now.textContent !== now) this.now.textContent = now;
    if (this.aim.textContent !== aim) this.aim.textContent = aim;
  }
}

/** Round values between two ends, some five of them. */
export function linesIn(low, high) {
  const rough = (high - low) / 5;
  const ten = 10 ** Math.floor(Math.log10(rough));
  const step = ten * ([1, 2, 5].find((factor) => factor * ten >= rough) ?? 10);
  const first = Math.ceil(low / step);
  return Array.from({ length: Math.floor(high / step) - first + 1 }, (_, i) => (first + i) * step);
}

/** What is shown of the quantity: the whole of the target, with room on both sides, and nothing. */
export function range(course, band) {
  const values = course ? Array.from(course.values) : [0, 2e-8];
  const [least, most] = [Math.min(0, ...values), Math.max(0, ...values)];
  const room = Math.max(2 * band, 0.35 * (most - least), 1e-9);
  return [least - room, most + room];
}

function disc(pen, x, y, radius, stroke, filled) {
  pen.beginPath();
  pen.arc(x, y, radius, 0, 7);
  pen.lineWidth = 3;
  pen.strokeStyle = pen.fillStyle = stroke;
  if (filled) pen.fill();
  else pen.stroke();
}
