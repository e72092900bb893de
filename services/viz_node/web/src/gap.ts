import { colour, make } from "./dom";
import { arrowShare, GAP_TICKS, gapShare, gapWords, limitWords } from "./gapscale";
import type { Store } from "./store";

const NM = 1e9;
const AFM = "afm/state/slave";
/** The speed of the tip is that over this time [s]. */
const SPEED_S = 0.25;
/** Room at the left for the numbers of the scale, and above and below for the tip and the sample [px]. */
const SCALE_PX = 58;
const ABOVE_PX = 62;
const BELOW_PX = 8;
/** The height of a number beside the scale [px]. */
const LABEL_PX = 14;
/** Half of the opening of the tip, and of the longest arrow [px]. */
const TIP_PX = 22;
const ARROW_PX = 56;
/** From the end of the tip to the words beside it [px]. */
const SAYS_PX = 10;

/** What is there to be seen: in nm and nN, of the newest samples. */
interface Seen {
  separation: number;
  force: number;
  touches: boolean;
  meniscus: boolean;
  limit: number;
}

/** Tip and sample from the side, and their distance on a scale that shows 0.1 nm as well as 100 nm. */
export class GapPicture {
  private readonly canvas = make("canvas", { "aria-hidden": "true" });
  private readonly words = { gap: make("b"), force: make("span", { class: "force" }), speed: make("span", { class: "quiet" }), limit: make("span", { class: "quiet", title: "Above this force the guard withdraws the tip: the line at the end of the force's scale" }) };
  private readonly says = make("div", { class: "says" }, this.words.gap, this.words.force, this.words.limit, this.words.speed);
  readonly root = make("div", { id: "gap", role: "img" }, this.canvas, this.says);
  private drawn = "";

  constructor(private readonly store: Store) {
    new ResizeObserver(() => (this.drawn = "")).observe(this.root);
  }

  /** Draw again although nothing has moved, as in other colours. */
  invalidate(): void {
    this.drawn = "";
  }

  /** Draw tip and sample, as often as there are frames. */
  draw(): void {
    const { clientWidth: width, clientHeight: height } = this.root;
    if (!width || !height) return;
    const { separation, force, touches, meniscus, limit } = this.seen();
    const top = ABOVE_PX;
    const bottom = height - BELOW_PX;
    const toY = (nm: number): number => bottom - gapShare(nm) * (bottom - top);
    const apex = Number.isNaN(separation) ? toY(100) : toY(separation);
    // half a pixel is not seen
    const key = [width, height, Math.round(2 * apex), Math.round(arrowShare(force, limit) * 2 * ARROW_PX), touches, meniscus, Number.isNaN(separation), limit].join();
    if (key === this.drawn) return;
    this.drawn = key;
    const ratio = devicePixelRatio;
    if (this.canvas.width !== Math.round(width * ratio) || this.canvas.height !== Math.round(height * ratio)) Object.assign(this.canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
    const pen = this.canvas.getContext("2d")!;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    pen.font = "12px system-ui";
    const x = SCALE_PX + Math.max(TIP_PX + 6, (width - SCALE_PX) * 0.25);
    // the words begin where the tip and the line of its limit end
    const left = `${x + TIP_PX + SAYS_PX}px`;
    if (this.says.style.left !== left) this.says.style.left = left;
    this.drawSample(pen, width, height, toY(0), x, touches ? apex : toY(0));
    this.drawScale(pen, width, toY, apex);
    // in contact the water stands around the end of the tip, in the dent that it makes
    const wet = touches ? apex : toY(0);
    if (meniscus) drawBridge(pen, x, Math.min(apex, wet - 6), wet, colour("water"));
    drawTip(pen, x, apex, width, Number.isNaN(separation) ? colour("line") : colour("quiet"));
    if (limitWords(limit)) drawLimit(pen, x, apex);
    drawArrow(pen, x, apex, arrowShare(force, limit) * ARROW_PX, colour("tip"));
  }

  /** Say it in words and numbers, together with the other numbers and no faster than a person can read. */
  write(): void {
    const { separation, force, touches, meniscus, limit } = this.seen();
    const words = { ...gapWords(separation, force, this.speed(), touches, meniscus), limit: limitWords(limit) };
    const label = `From the side: the tip is ${words.gap}; ${words.force}${words.limit && `, ${words.limit}`}; it ${words.speed.replace(/^(?=\d)/, "moves ")}`;
    if (this.root.getAttribute("aria-label") !== label) this.root.setAttribute("aria-label", label);
    for (const [name, text] of Object.entries(words)) {
      const line = this.words[name as keyof typeof words];
      if (line.textContent !== text) line.textContent = text;
    }
  }

  private seen(): Seen {
    const { store } = this;
    return {
      separation: store.last("tip", "separation") * NM,
      force: store.last("tip", "force") * NM,
      touches: store.fact(AFM, "in_contact") === true,
      meniscus: store.fact(AFM, "meniscus") === true,
      // what is felt in the place of a force has no limit in newtons
      limit: typeof store.fact(AFM, "felt_channel") === "string" ? NaN : store.forceLimit_n * NM,
    };
  }

  private drawSample(pen: CanvasRenderingContext2D, width: number, height: number, surface: number, x: number, dent: number): void {
    pen.fillStyle = colour("sample-back");
    pen.strokeStyle = colour("sample");
    pen.lineWidth = 2;
    pen.beginPath();
    pen.moveTo(SCALE_PX, surface);
    if (dent > surface) {
      pen.lineTo(x - 2 * TIP_PX, surface);
      pen.quadraticCurveTo(x - 0.4 * TIP_PX, surface, x, dent);
      pen.quadraticCurveTo(x + 0.4 * TIP_PX, surface, x + 2 * TIP_PX, surface);
    }
    pen.lineTo(width, surface);
    pen.stroke();
    pen.lineTo(width, height);
    pen.lineTo(SCALE_PX, height);
    pen.fill();
    pen.fillStyle = colour("text");
    pen.fillText("sample", width - 4 - pen.measureText("sample").width, height - BELOW_PX);
  }

  private drawScale(pen: CanvasRenderingContext2D, width: number, toY: (nm: number) => number, apex: number): void {
    pen.textAlign = "right";
    for (const nm of GAP_TICKS) {
      pen.fillStyle = colour("line");
      if (nm !== 0) pen.fillRect(SCALE_PX, toY(nm), width - SCALE_PX, 1);
      // a number that has no room beside that of the surface is left out
      if (nm !== 0 && Math.abs(toY(nm) - toY(0)) < LABEL_PX) continue;
      pen.fillStyle = colour("quiet");
      pen.fillText(nm === 100 || nm === 0 ? `${nm} nm` : `${nm}`, SCALE_PX - 10, toY(nm) + 4);
    }
    pen.textAlign = "left";
    // where on the scale the tip is
    pen.fillStyle = colour("tip");
    pen.beginPath();
    pen.moveTo(SCALE_PX, apex);
    pen.lineTo(SCALE_PX - 8, apex - 5);
    pen.lineTo(SCALE_PX - 8, apex + 5);
    pen.fill();
  }

  /** How fast the tip moves away from the sample [nm/s]; NaN where that is not known. */
  private speed(): number {
    const ring = this.store.rings.get("tip");
    const column = this.store.column("tip", "separation");
    if (!ring?.length || column < 0 || this.store.source.kind === "recording") return NaN;
    const first = ring.indexAt(ring.newest - SPEED_S);
    const time = ring.newest - ring.time(first);
    return time > 0 ? ((ring.value(column, ring.length - 1) - ring.value(column, first)) * NM) / time : NaN;
  }
}

function drawTip(pen: CanvasRenderingContext2D, x: number, apex: number, width: number, fill: string): void {
  pen.fillStyle = fill;
  const base = apex - ABOVE_PX + 14;
  pen.beginPath();
  pen.moveTo(x - TIP_PX, base);
  pen.quadraticCurveTo(x - 5, apex - 4, x, apex);
  pen.quadraticCurveTo(x + 5, apex - 4, x + TIP_PX, base);
  pen.fill();
  // the cantilever, which comes from the left
  pen.fillRect(SCALE_PX, base - 8, Math.min(width, x + TIP_PX + 2) - SCALE_PX, 9);
}

/** A water bridge between the apex and the surface. */
function drawBridge(pen: CanvasRenderingContext2D, x: number, apex: number, surface: number, fill: string): void {
  const [top, bottom] = [Math.min(apex, surface) - 8, Math.max(apex, surface)];
  const middle = (top + bottom) / 2;
  pen.fillStyle = fill;
  pen.beginPath();
  pen.moveTo(x - 9, top);
  pen.quadraticCurveTo(x - 4, middle, x - 20, bottom);
  pen.lineTo(x + 20, bottom);
  pen.quadraticCurveTo(x + 4, middle, x + 9, top);
  pen.fill();
}

/** Where the arrow of a force ends that the guard withdraws the tip for. */
function drawLimit(pen: CanvasRenderingContext2D, x: number, apex: number): void {
  pen.fillStyle = colour("text");
  pen.fillRect(x - TIP_PX - 4, apex - ARROW_PX - 1, 2 * TIP_PX + 8, 2);
}

/** The force on the tip: up where the sample pushes, down where it pulls. */
function drawArrow(pen: CanvasRenderingContext2D, x: number, from: number, length: number, style: string): void {
  if (length === 0) return;
  const to = from - length;
  const head = Math.sign(length) * Math.min(10, Math.abs(length));
  pen.strokeStyle = pen.fillStyle = style;
  pen.lineWidth = 4;
  pen.beginPath();
  pen.moveTo(x, from);
  pen.lineTo(x, to + head);
  pen.stroke();
  pen.beginPath();
  pen.moveTo(x, to);
  pen.lineTo(x - 7, to + head);
  pen.lineTo(x + 7, to + head);
  pen.fill();
}
