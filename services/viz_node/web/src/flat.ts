import { colourOf } from "./colormap";
import { colour, make } from "./dom";
import type { Section } from "./section";
import type { Surface } from "./surface";
import { fixed } from "./numbers";

type Extent = NonNullable<Surface["extent"]>;
const MARGIN = 26;
/** Share of the image that an arrow key moves the line by. */
const KEY_STEP = 0.02;

/** The image seen from above, x to the right and y up; dragging over it draws the line of the profile. */
export class Flat {
  readonly canvas = make("canvas", { role: "img", tabindex: 0, "aria-label": "The image from above, coloured by height: drag a line for its profile, or move it with the arrow keys, its end with Shift" });
  private readonly note = make("div", { class: "over" }, "No image yet: the button Image takes one");
  readonly element = make("div", { class: "flat", hidden: true }, this.canvas, this.note);
  onPlace: (x: number, y: number) => void = () => {};
  tool: () => string = () => "profile";
  overlay: (pen: CanvasRenderingContext2D, at: (x: number, y: number) => [number, number], scale: number) => void = () => {};
  grab: (x: number, y: number) => ((x: number, y: number) => void) | undefined = () => undefined;
  private readonly picture = make("canvas");
  private isDirty = true;
  private isStale = true;
  private tipAt = "";
  /** Left, top, and length of a nanometre on the canvas. */
  private frame = { left: 0, top: 0, scale: 1 };

  constructor(
    private readonly surface: Surface,
    private readonly section: Section,
    private readonly tip: () => [number, number],
  ) {
    new ResizeObserver(() => (this.isDirty = true)).observe(this.element);
    this.canvas.addEventListener("pointerdown", (event) => this.beginDrag(event));
    this.canvas.addEventListener("pointermove", (event) => this.read(event));
    this.canvas.addEventListener("keydown", (event) => this.moveByKey(event));
  }

  invalidate(): void {
    this.isDirty = this.isStale = true;
  }

  /** Draw again what is over the image. */
  redraw(): void {
    this.isDirty = true;
  }

  /** Draw with a frame, if something has changed that is seen. */
  draw(): void {
    if (this.element.hidden) return;
    const tip = this.tip();
    const tipAt = tip.map((at) => fixed(at, 1)).join();
    if (!this.isDirty && tipAt === this.tipAt) return;
    this.isDirty = false;
    this.tipAt = tipAt;
    const { clientWidth: width, clientHeight: height } = this.element;
    const ratio = devicePixelRatio;
    if (this.canvas.width !== Math.round(width * ratio) || this.canvas.height !== Math.round(height * ratio)) {
      Object.assign(this.canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
      this.canvas.style.width = `${width}px`;
      this.canvas.style.height = `${height}px`;
    }
    const pen = this.canvas.getContext("2d")!;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    const extent = this.surface.extent;
    this.note.hidden = extent !== undefined;
    if (!extent) return;
    if (this.isStale) this.paint();
    this.isStale = false;
    const scale = Math.min((width - 2 * MARGIN) / extent.width, (height - 2 * MARGIN) / extent.depth);
    this.frame = { left: (width - extent.width * scale) / 2, top: (height - extent.depth * scale) / 2 - 4, scale };
    pen.imageSmoothingEnabled = false;
    pen.drawImage(this.picture, this.frame.left, this.frame.top, extent.width * scale, extent.depth * scale);
    this.drawAxes(pen, extent, height);
    this.drawLine(pen, extent);
    this.overlay(pen, (atX, atY) => this.toCanvas(extent, atX, atY), scale);
    const [x, y] = this.toCanvas(extent, tip[0], tip[1]);
    if (Number.isFinite(x) && Number.isFinite(y)) {
      pen.strokeStyle = colour("tip");
      pen.lineWidth = 2;
      pen.beginPath();
      pen.moveTo(x - 7, y);
      pen.lineTo(x + 7, y);
      pen.moveTo(x, y - 7);
      pen.lineTo(x, y + 7);
      pen.stroke();
    }
  }

  /** The image by itself, one pixel for each measured point and no fewer than 512 across, with a bar of its colours. */
  export(): HTMLCanvasElement {
    this.paint();
    const extent = this.surface.extent!;
    const factor = Math.max(1, Math.ceil(512 / this.picture.width));
    const [width, height] = [this.picture.width * factor, Math.round((this.picture.width * factor * extent.depth) / extent.width)];
    const sheet = make("canvas", { width: width + 110, height: height + 46 });
    const pen = sheet.getContext("2d")!;
    pen.fillStyle = "#ffffff";
    pen.fillRect(0, 0, sheet.width, sheet.height);
    pen.imageSmoothingEnabled = false;
    pen.drawImage(this.picture, 10, 10, width, height);
    const { range, base, palette } = this.surface;
    for (let i = 0; i < height; i++) {
      pen.fillStyle = css(colourOf(palette, 1 - i / height));
      pen.fillRect(width + 24, 10 + i, 18, 1.5);
    }
    pen.fillStyle = "#16202a";
    pen.font = "14px system-ui, sans-serif";
    pen.fillText(`${+(range[1] - base).toPrecision(4)} nm`, width + 48, 22);
    pen.fillText(`${+(range[0] - base).toPrecision(4)} nm`, width + 48, height + 10);
    pen.fillText(`${+extent.width.toPrecision(4)} nm × ${+extent.depth.toPrecision(4)} nm`, 10, height + 34);
    return sheet;
  }

  private paint(): void {
    const { shown, rows, columns } = this.surface.grid();
    Object.assign(this.picture, { width: columns, height: rows });
    const pen = this.picture.getContext("2d")!;
    const data = pen.createImageData(columns, rows);
    const [low, high] = this.surface.range;
    for (let row = 0; row < rows; row++) {
      for (let column = 0; column < columns; column++) {
        const value = shown[row * columns + column]!;
        if (Number.isNaN(value)) continue;
        const rgb = colourOf(this.surface.palette, (value - low) / (high - low || 1));
        // the first line of the picture is its highest y
        data.data.set([rgb[0] * 255, rgb[1] * 255, rgb[2] * 255, 255], 4 * ((rows - 1 - row) * columns + column));
      }
    }
    pen.putImageData(data, 0, 0);
  }

  private drawAxes(pen: CanvasRenderingContext2D, extent: Extent, height: number): void {
    const { left, top, scale } = this.frame;
    pen.strokeStyle = colour("edge");
    pen.lineWidth = 1;
    pen.strokeRect(left, top, extent.width * scale, extent.depth * scale);
    pen.fillStyle = colour("quiet");
    pen.font = "11px system-ui";
    pen.textAlign = "center";
    pen.fillText(`x ${text(extent.x - extent.width / 2)} … ${text(extent.x + extent.width / 2)} nm`, left + (extent.width * scale) / 2, Math.min(height - 4, top + extent.depth * scale + 14));
    pen.save();
    pen.translate(left - 6, top + (extent.depth * scale) / 2);
    pen.rotate(-Math.PI / 2);
    pen.fillText(`y ${text(extent.y - extent.depth / 2)} … ${text(extent.y + extent.depth / 2)} nm`, 0, 0);
    pen.restore();
  }

  private drawLine(pen: CanvasRenderingContext2D, extent: Extent): void {
    const line = this.section.line;
    if (!line) return;
    const [from, to] = line.map((at) => this.toCanvas(extent, at[0], at[1])) as [[number, number], [number, number]];
    for (const [style, width] of [["#ffffff", 4], ["#d6006f", 2]] as const) {
      pen.strokeStyle = style;
      pen.lineWidth = width;
      pen.beginPath();
      pen.moveTo(...from);
      pen.lineTo(...to);
      pen.stroke();
    }
  }

  private toCanvas(extent: Extent, x: number, y: number): [number, number] {
    const { left, top, scale } = this.frame;
    return [left + (x - extent.x + extent.width / 2) * scale, top + (extent.y + extent.depth / 2 - y) * scale];
  }

  private toSample(event: PointerEvent): [number, number] | undefined {
    const extent = this.surface.extent;
    if (!extent) return undefined;
    const { left, top, scale } = this.frame;
    const within = (value: number, half: number, middle: number): number => Math.min(middle + half, Math.max(middle - half, value));
    return [
      within((event.offsetX - left) / scale + extent.x - extent.width / 2, extent.width / 2, extent.x),
      within(extent.y + extent.depth / 2 - (event.offsetY - top) / scale, extent.depth / 2, extent.y),
    ];
  }

  private beginDrag(event: PointerEvent): void {
    const from = this.toSample(event);
    if (!from || event.button !== 0) return;
    const places = this.tool() === "place";
    const grabbed = places ? undefined : this.grab(...from);
    if (places) this.onPlace(...from);
    this.canvas.setPointerCapture(event.pointerId);
    const move = (moved: PointerEvent): void => {
      const to = this.toSample(moved);
      if (!to) return;
      if (places) this.onPlace(...to);
      else if (grabbed) grabbed(...to);
      else if (Math.hypot(to[0] - from[0], to[1] - from[1]) > 0.01) {
        this.section.set(from, to);
        if (!this.section.isOn) this.section.setOn(true);
      }
    };
    const end = (): void => {
      this.canvas.removeEventListener("pointermove", move);
      for (const name of ["pointerup", "pointercancel"]) this.canvas.removeEventListener(name, end);
    };
    this.canvas.addEventListener("pointermove", move);
    for (const name of ["pointerup", "pointercancel"]) this.canvas.addEventListener(name, end);
  }

  /** Move the line of the profile with the arrow keys, with Shift its end alone. */
  private moveByKey(event: KeyboardEvent): void {
    const [x, y] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key] ?? [0, 0];
    const extent = this.surface.extent;
    if (!(x || y) || !extent) return;
    event.preventDefault();
    if (!this.section.isOn) this.section.setOn(true);
    const line = this.section.line;
    if (!line) return;
    const moved = (at: readonly [number, number]): [number, number] => [at[0] + x! * KEY_STEP * extent.width, at[1] + y! * KEY_STEP * extent.depth];
    this.section.set(event.shiftKey ? line[0] : moved(line[0]), moved(line[1]));
  }

  private read(event: PointerEvent): void {
    const at = this.toSample(event);
    const found = at && this.surface.nearest(...at);
    this.canvas.title = found ? `x ${text(found.at[0])} nm, y ${text(found.at[1])} nm, height ${+(found.shown - this.surface.base).toPrecision(4)} nm` : "";
  }
}

function text(value: number): string {
  return `${+value.toPrecision(3)}`;
}

function css(rgb: readonly number[]): string {
  return `rgb(${rgb.map((part) => Math.round(part * 255)).join(",")})`;
}
