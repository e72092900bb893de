import type { Cockpit, Panel } from "../cockpit";
import { noMoment, type Span } from "../document";
import { colour, make } from "../dom";
import type { Ring } from "../ring";
import { plain } from "../sentences";
import { INTERRUPTIONS, kindOf } from "./summary";
import { fixed } from "../numbers";

const RATES = [0.1, 0.25, 0.5, 1, 2, 5, 10, 50];
const RATE_STEP = Math.SQRT2;
/** The stream that the key n steps through. */
const STEPPED = "tip";
const BAND = 16;
const EDGE = 6;
/** An interruption of no length is said for this long [s]. */
const MARK_S = 0.05;
/** What each phase is called, and the colour of its band. */
const PHASES: Record<string, readonly [string, string]> = {
  apart: ["apart", "inset"],
  approach: ["approach", "line"],
  contact: ["contact", "line"],
  hold: ["hold", "line"],
  release: ["release", "line"],
  released: ["released", "inset"],
};
const KEYS = "Keys as in telenano replay: space plays, ← → 1 s, . and , 1 ms, n the next sample of the instrument, e and E the next event and the one before, + − the rate, a b the ends of a stretch, l loops it, c cursors";

/** The whole of a recording: its phases, what happened when, the verdict of each hold, and where the playhead is. */
export class TimelinePanel implements Panel {
  private readonly canvas = make("canvas", { "aria-hidden": "true" });
  private readonly track = make("div", { class: "track", id: "place", tabindex: 0, role: "slider", "aria-label": "Place in the recording", "aria-valuemin": 0 }, this.canvas);
  private readonly play = make("button", { type: "button", id: "play", "aria-keyshortcuts": "Space", onclick: () => void this.toggle() }, "Play");
  private readonly rate = make("select", { id: "rate", "aria-label": "Rate", onchange: () => void this.setRate(Number(this.rate.value)) }, ...RATES.map((rate) => make("option", { value: rate }, `${rate} ×`)));
  private readonly loop = make("button", { type: "button", id: "loop", "aria-pressed": "false", "aria-keyshortcuts": "l", onclick: () => this.toggleLoop() }, "Loop");
  private readonly text = make("span", { id: "place-text" });
  private readonly event = make("span", { class: "quiet", id: "place-event" });
  private readonly stretch = make("span", { class: "quiet", id: "stretch-text" });
  private drawnFor = "";

  constructor(
    root: HTMLElement,
    private readonly cockpit: Cockpit,
  ) {
    const button = (id: string, text: string, label: string, action: () => void): HTMLButtonElement => make("button", { type: "button", id, "aria-label": label, title: label, onclick: action }, text);
    root.append(
      make(
        "div",
        { class: "toolbar" },
        this.play,
        make("div", { class: "segments", role: "group", "aria-label": "Events" }, button("event-before", "‹ Event", "The event before", () => this.toMoment(false)), button("event-next", "Event ›", "The next event", () => this.toMoment(true))),
        this.text,
        this.event,
        make("span", { class: "spacer" }),
        this.stretch,
        make("div", { class: "segments", role: "group", "aria-label": "Stretch" }, button("stretch-a", "A", "The selected part begins here", () => this.choose(0)), button("stretch-b", "B", "The selected part ends here", () => this.choose(1)), this.loop),
        this.rate,
        make("button", { type: "button", class: "icon plain", title: KEYS, "aria-label": KEYS, onclick: () => this.cockpit.commands.tell(KEYS) }, "?"),
      ),
      this.track,
      make("p", { class: "quiet marks" }, make("span", { class: "mark-hold" }, "holds, by their verdict"), make("span", { class: "mark-interrupted" }, "interrupted"), make("span", { class: "mark-lost" }, "messages missing"), make("span", { class: "mark-event" }, "events")),
    );
    this.listen();
    new ResizeObserver(() => (this.drawnFor = "")).observe(this.track);
  }

  begin(): void {
    const may = this.cockpit.store.role === "operator";
    for (const control of [this.play, this.rate]) control.disabled = !may;
    this.drawnFor = "";
  }

  frame(now: number): void {
    const { document, store } = this.cockpit;
    if (!document.isThere) return;
    const at = document.at(now);
    const [a, b] = document.chosen;
    if (document.isLooped && store.source.playing && b !== undefined && at >= b) document.seek(a ?? 0);
    const key = [Math.round((at / (document.length || 1)) * this.track.clientWidth * 2), document.version, a, b, document.about?.read].join();
    if (key === this.drawnFor) return;
    this.drawnFor = key;
    this.draw(at);
  }

  write(): void {
    const { document, store } = this.cockpit;
    const now = performance.now();
    const at = document.at(now);
    const { length } = document;
    this.text.textContent = `${fixed(at, length < 60 ? 3 : 1)} of ${fixed(length, 1)} s`;
    this.play.textContent = store.source.playing ? "Pause" : "Play";
    this.play.setAttribute("aria-pressed", String(store.source.playing === true));
    const rate = store.source.rate ?? 1;
    const nearest = RATES.reduce((best, option) => (Math.abs(Math.log(option / rate)) < Math.abs(Math.log(best / rate)) ? option : best));
    if (globalThis.document.activeElement !== this.rate) this.rate.value = String(nearest);
    this.track.setAttribute("aria-valuemax", fixed(length, 3));
    this.track.setAttribute("aria-valuenow", fixed(at, 3));
    const phase = (document.about?.phases ?? []).find((found) => found.from_s <= at && at < found.to_s);
    const hold = phase?.kind === "hold" ? document.holdAt(at) : undefined;
    const interruption = (document.about?.interruptions ?? []).find((found) => found.from_s <= at && at < Math.max(found.to_s, found.from_s + MARK_S));
    const isLost = (document.about?.losses ?? []).some((found) => found.from_s <= at && at < found.to_s);
    const moment = (document.about?.moments ?? []).find((found) => Math.abs(found.t_s - at) < Math.max(0.002, length / 2000));
    const words = [
      phase ? PHASES[phase.kind]?.[0] : "",
      hold ? `${hold.verdict.replaceAll("_", " ")} at ${+hold.hand_force_n.toPrecision(3)} N${hold.frequency_hz ? `, ${hold.peak_to_peak_n.toPrecision(2)} N peak to peak at ${hold.frequency_hz.toPrecision(2)} Hz` : ""}` : "",
      isLost ? "messages are missing here" : "",
      interruption ? `interrupted: ${INTERRUPTIONS[interruption.kind] ?? plain(interruption.reason)}` : "",
      moment ? plain(moment.text) : "",
      document.progress,
    ].filter(Boolean).join(" · ");
    if (this.event.textContent !== words) this.event.textContent = words;
    this.track.setAttribute("aria-valuetext", `${fixed(at, 3)} s of ${fixed(length, 1)} s${words ? `, ${words}` : ""}`);
    const [a, b] = document.chosen;
    const stretch = a === undefined && b === undefined ? "" : `A ${a === undefined ? "–" : fixed(a, 3)} s, B ${b === undefined ? "–" : fixed(b, 3)} s: CSV saves it`;
    if (this.stretch.textContent !== stretch) this.stretch.textContent = stretch;
  }

  recolour(): void {
    this.drawnFor = "";
  }

  /** A key of the page: returns whether it was one of the recording's. */
  key(event: KeyboardEvent): boolean {
    const { document, store } = this.cockpit;
    const at = document.at(performance.now());
    const rate = store.source.rate ?? 1;
    const actions: Record<string, () => void> = {
      " ": () => void this.toggle(),
      ArrowRight: () => document.seek(at + 1),
      ArrowLeft: () => document.seek(at - 1),
      ".": () => this.stepTo(at + 1e-3),
      ",": () => this.stepTo(at - 1e-3),
      n: () => this.stepTo(document.sampleAfter(STEPPED, at)),
      Home: () => document.seek(0),
      End: () => document.seek(document.length),
      e: () => this.toMoment(true),
      E: () => this.toMoment(false),
      "+": () => void this.setRate(rate * RATE_STEP),
      "-": () => void this.setRate(rate / RATE_STEP),
      a: () => this.choose(0),
      b: () => this.choose(1),
      l: () => this.toggleLoop(),
    };
    const action = document.isThere ? actions[event.key] : undefined;
    if (!action) return false;
    event.preventDefault();
    action();
    return true;
  }

  private async toggle(): Promise<void> {
    const { commands, store } = this.cockpit;
    await commands.ask(store.source.playing ? "pause" : "play", { k: "transport", action: store.source.playing ? "pause" : "play", value: 0 });
  }

  private async setRate(rate: number): Promise<void> {
    await this.cockpit.commands.ask("rate", { k: "transport", action: "rate", value: Math.min(100, Math.max(0.01, rate)) });
  }

  private toMoment(forwards: boolean): void {
    const { document, commands } = this.cockpit;
    const found = document.moment(document.at(performance.now()), forwards);
    if (found) this.stepTo(found.t_s);
    else commands.tell(noMoment(forwards, document.about?.read ?? 0));
  }

  /** Go to a place to look at it: what plays would run away from there. */
  private stepTo(place: number): void {
    const { document, store } = this.cockpit;
    if (store.source.playing) void document.transport("pause");
    document.seek(place);
  }

  /** The stretch begins, or ends, at the playhead; pressed at the same place again it has no such end. */
  private choose(end: 0 | 1): void {
    const { document } = this.cockpit;
    const at = document.at(performance.now());
    document.chosen[end] = document.chosen[end] !== undefined && Math.abs(document.chosen[end] - at) < 1e-3 ? undefined : at;
    const [a, b] = document.chosen;
    if (a !== undefined && b !== undefined && b < a) document.chosen = [b, a];
  }

  private toggleLoop(): void {
    const { document } = this.cockpit;
    document.isLooped = !document.isLooped;
    this.loop.setAttribute("aria-pressed", String(document.isLooped));
  }

  private listen(): void {
    const place = (event: PointerEvent): number => {
      const box = this.track.getBoundingClientRect();
      const share = (event.clientX - box.left - EDGE) / (box.width - 2 * EDGE);
      return Math.min(1, Math.max(0, share)) * this.cockpit.document.length;
    };
    this.track.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      this.track.setPointerCapture(event.pointerId);
      this.cockpit.document.seek(place(event));
    });
    this.track.addEventListener("pointermove", (event) => {
      if (this.track.hasPointerCapture(event.pointerId)) this.cockpit.document.seek(place(event));
    });
  }

  private draw(at: number): void {
    const { document, store } = this.cockpit;
    const { clientWidth: width, clientHeight: height } = this.track;
    const ratio = devicePixelRatio;
    Object.assign(this.canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
    const pen = this.canvas.getContext("2d")!;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    const length = document.length || 1;
    const toX = (time: number): number => EDGE + (time / length) * (width - 2 * EDGE);
    const [a, b] = document.chosen;
    if (a !== undefined || b !== undefined) {
      pen.fillStyle = colour("line");
      pen.fillRect(toX(a ?? 0), 0, toX(b ?? length) - toX(a ?? 0), height);
    }
    const bottom = height - BAND - 3;
    const whole = document.whole;
    if (whole) {
      this.curve(pen, whole.rings.get("hand"), store.column("hand", "force"), "hand", toX, bottom);
      this.curve(pen, whole.rings.get("command"), store.column("command", "tip_force"), "tip", toX, bottom);
    }
    for (const { from_s, to_s } of document.about?.losses ?? []) {
      pen.fillStyle = colour("bad-back");
      this.block(pen, toX(from_s), toX(to_s), bottom, "bad");
    }
    for (const { from_s, to_s } of document.about?.interruptions ?? []) {
      pen.fillStyle = colour("warn-back");
      this.block(pen, toX(from_s), toX(to_s), bottom, "warn");
    }
    // a verdict that was kept has its holds before all phases are known
    const spans = document.about?.phases ?? (document.about?.holds ?? []).map(({ from_s, to_s }) => ({ kind: "hold", from_s, to_s }));
    for (const phase of spans) this.band(pen, phase, toX, height);
    for (const moment of document.about?.moments ?? []) {
      if (moment.kind === "node" && moment.level === "info") continue;
      const x = toX(moment.t_s);
      pen.fillStyle = colour(moment.level === "error" ? "bad" : moment.level === "warning" ? "warn" : moment.kind === "mark" ? "text" : "edge");
      pen.beginPath();
      pen.moveTo(x - 4, 0);
      pen.lineTo(x + 4, 0);
      pen.lineTo(x, 7);
      pen.fill();
      if (moment.kind === "contact" || moment.kind === "lost" || moment.kind === "mark") pen.fillRect(x - 0.5, 0, 1, bottom);
    }
    pen.fillStyle = colour("text");
    pen.fillRect(toX(at) - 1, 0, 2, height);
  }

  /** A time that is marked over the curves: its back is filled, and its ends and upper edge are drawn. */
  private block(pen: CanvasRenderingContext2D, from: number, to: number, bottom: number, name: string): void {
    const width = Math.max(3, to - from);
    pen.globalAlpha = 0.75;
    pen.fillRect(from, 0, width, bottom);
    pen.globalAlpha = 1;
    pen.fillStyle = colour(name);
    pen.fillRect(from, 0, width, 3);
    pen.fillRect(from, 0, 1, bottom);
    pen.fillRect(from + width - 1, 0, 1, bottom);
  }

  private band(pen: CanvasRenderingContext2D, phase: Span, toX: (time: number) => number, height: number): void {
    const [name, fill] = PHASES[phase.kind] ?? [phase.kind, "line"];
    const middle = (phase.from_s + phase.to_s) / 2;
    const hold = phase.kind === "hold" ? this.cockpit.document.holdAt(middle) : undefined;
    const verdict = hold?.verdict ?? "";
    const [x0, x1] = [toX(phase.from_s), toX(phase.to_s)];
    const kind = hold && verdict !== "released" ? kindOf(verdict) : "";
    pen.fillStyle = colour(kind ? `${kind}-back` : fill);
    pen.fillRect(x0 + 0.5, height - BAND, Math.max(1, x1 - x0 - 1), BAND);
    const text = hold ? `${hold.frequency_hz ? `${+hold.frequency_hz.toPrecision(2)} Hz` : `${+hold.hand_force_n.toPrecision(2)} N`} ${verdict.replaceAll("_", " ")}` : name;
    pen.font = "600 11px system-ui";
    pen.fillStyle = colour(kind || "quiet");
    if (kind) pen.fillRect(x0 + 0.5, height - BAND, Math.max(1, x1 - x0 - 1), 2);
    if (pen.measureText(text).width < x1 - x0 - 8) pen.fillText(text, x0 + 5, height - 4);
  }

  /** A curve by the least and the greatest values that it has in each span of the whole. */
  private curve(pen: CanvasRenderingContext2D, ring: Ring | undefined, column: number, name: string, toX: (time: number) => number, bottom: number): void {
    if (!ring?.length || column < 0) return;
    const [low, high] = this.bounds();
    const toY = (value: number): number => bottom - ((value - low) / (high - low)) * (bottom - 9);
    pen.strokeStyle = colour(name);
    pen.lineWidth = 1.25;
    pen.beginPath();
    let isDown = false;
    for (let i = 0; i < ring.length; i++) {
      const value = ring.value(column, i);
      if (Number.isNaN(value)) {
        isDown = false;
        continue;
      }
      if (isDown) pen.lineTo(toX(ring.time(i)), toY(value));
      else pen.moveTo(toX(ring.time(i)), toY(value));
      isDown = true;
    }
    pen.stroke();
  }

  private bounds(): [number, number] {
    const { document, store } = this.cockpit;
    let [low, high] = [-0.1, 0.1];
    for (const [stream, column] of [["hand", "force"], ["command", "tip_force"]] as const) {
      const ring = document.whole?.rings.get(stream);
      const index = store.column(stream, column);
      for (let i = 0; ring && index >= 0 && i < ring.length; i++) {
        const value = ring.value(index, i);
        if (value < low) low = value;
        if (value > high) high = value;
      }
    }
    return [low, high];
  }
}
