import type { Cockpit, Panel } from "../cockpit";
import { colour, make, save } from "../dom";
import { Pace } from "../pace";
import { Playhead } from "../playhead";
import type { Ring } from "../ring";
import { recordingMenu } from "../recording";
import { OLD_S } from "../freshness";
import { drawnAs } from "../scopes/catalog";
import { BUILT_IN, Layouts, moved, overlaid, type ScopeSpec } from "../scopes/layout";
import { columnsOf, Plot, type Window } from "../scopes/plot";
import { measure, neighbour, readAt, type Reading, type Samples, type Stretch } from "../scopes/reading";
import { sheetOf } from "../scopes/sheet";
import { fixed } from "../numbers";

/** Where frames are slow the curves are drawn in every second one, so that the page still answers. */
const SLOW_SHARE = 2;
const SPANS = [0.1, 0.5, 1, 2, 5, 10, 30, 60, 300, 3600];
const LONGEST_LIVE = 60;
const CURSOR_STEP = 1 / 200;
/** All samples are asked for when a cursor has stood still for this long [ms], of a stretch of at most this length [s]. */
const REST_MS = 120;
const LONGEST_STRETCH = 60;
/** How far around a cursor they are asked for [s]. */
const AROUND = 0.3;
const HEADS = ["", "A", "B", "B − A", "peak to peak", "mean", "turns at"];

/** The scopes: which there are, what span they show, two cursors, and what is saved of them. */
export class ScopesPanel implements Panel {
  plots: Plot[] = [];
  specs: ScopeSpec[] = [];
  cursors: [Reading, Reading] | undefined;
  span = 10;
  private readonly layouts = new Layouts(() => localStorage);
  private layout: string;
  private enlarged = -1;
  private pausedAt: number | undefined;
  private readonly playhead = new Playhead();
  private readonly pace = new Pace(SLOW_SHARE);
  private drawnFor = "";
  private shownWindow: Window | undefined;
  private moving: 0 | 1 = 0;
  /** What was measured between the cursors, by the names of the columns. */
  private stretch = new Map<string, Stretch>();
  private placed = 0;
  private restTimer: ReturnType<typeof setTimeout> | undefined;
  private readonly grid = make("div", { class: "plots" });
  private readonly measures = make("div", { class: "measures", hidden: true, tabindex: 0, role: "status", "aria-label": "Values at the cursors" });
  private readonly spanSelect = make("select", { id: "span", "aria-label": "Span of the scopes", onchange: () => this.setSpan(Number(this.spanSelect.value)) });
  private readonly pauseButton = make("button", { type: "button", id: "pause", "aria-pressed": "false", onclick: () => this.pause() }, "Pause");
  private readonly cursorButton = make("button", { type: "button", id: "cursors", "aria-pressed": "false", "aria-keyshortcuts": "c", onclick: () => this.toggleCursors() }, "Cursors");
  private readonly layoutSelect = make("select", { id: "layout", "aria-label": "Layout of the scopes", onchange: () => this.take(this.layoutSelect.value) });
  private readonly layoutName = make("input", { id: "layout-name", type: "text", placeholder: "Name of the layout", "aria-label": "Name of the layout", maxlength: 40, hidden: true });
  private readonly layoutRemove = make("button", { type: "button", id: "layout-remove", hidden: true, onclick: () => this.removeLayout() }, "Remove");
  private readonly seen: IntersectionObserver;
  private sheet: HTMLElement | undefined;
  private dragged = -1;

  constructor(
    private readonly root: HTMLElement,
    private readonly cockpit: Cockpit,
  ) {
    root.style.position = "relative";
    const kept = this.layouts.now;
    [this.layout, this.specs] = [kept.name, kept.specs];
    const button = (id: string, text: string, action: () => unknown): HTMLButtonElement => make("button", { type: "button", id, onclick: () => void action() }, text);
    this.layoutName.addEventListener("keydown", (event) => event.key === "Enter" && this.saveLayout());
    const toolbar = make(
      "div",
      { class: "toolbar" },
      make("h2", {}, "Scopes"),
      this.layoutSelect,
      button("layout-save", "Save as", () => this.saveLayout()),
      this.layoutName,
      this.layoutRemove,
      button("scope-add", "Add", () => this.add()),
      make("span", { class: "spacer" }),
      this.cursorButton,
      make("label", {}, "Span", this.spanSelect),
      this.pauseButton,
      make("div", { class: "segments", role: "group", "aria-label": "Save" }, button("save-png", "Save PNG", () => this.savePicture()), button("save-csv", "CSV", async () => this.saveSamples())),
      recordingMenu(cockpit),
    );
    root.append(toolbar, this.grid, this.measures);
    new ResizeObserver(() => {
      this.plots.forEach((plot) => plot.resize());
      this.fitNames();
      this.invalidate();
    }).observe(this.grid);
    this.seen = new IntersectionObserver((entries) => {
      for (const entry of entries) {
        const plot = this.plots.find((found) => found.area.parentElement === entry.target);
        if (plot) plot.isSeen = entry.isIntersecting;
      }
      this.invalidate();
    });
    this.fillSpans();
    this.fillLayouts();
    cockpit.document.onChange = () => this.invalidate();
  }

  begin(): void {
    const isRecording = this.cockpit.document.isThere;
    this.pauseButton.hidden = isRecording;
    this.fillSpans();
    this.build();
  }

  recolour(): void {
    this.plots.forEach((plot) => plot.recolour());
    this.invalidate();
  }

  /** Draw with the next frame, also what does not move. */
  invalidate(): void {
    this.drawnFor = "";
  }

  pause(): void {
    if (this.cockpit.document.isThere) return;
    this.pausedAt = this.pausedAt === undefined ? this.playhead.at : undefined;
    this.pauseButton.setAttribute("aria-pressed", String(this.pausedAt !== undefined));
    this.pauseButton.textContent = this.pausedAt === undefined ? "Pause" : "Continue";
  }

  setSpan(span: number): void {
    this.span = span;
    this.spanSelect.value = String(span);
    this.invalidate();
  }

  frame(now: number): void {
    if (!this.pace.isDue(now)) return;
    const window = this.windowAt(now);
    if (!window) return;
    const key = [window.from, window.to, window.now, this.cockpit.document.version, ...(window.cursors ?? [])].join();
    if (key === this.drawnFor) return;
    this.pace.drawn(now);
    this.drawnFor = key;
    this.shownWindow = window;
    for (const plot of this.plots) if (plot.isSeen) plot.draw(window);
  }

  write(): void {
    this.writeMeasures();
  }

  toggleCursors(): void {
    const window = this.windowAt(performance.now());
    if (this.cursors || !window) this.cursors = undefined;
    else {
      if (this.pausedAt === undefined) this.pause();
      const [a, b] = [1 / 3, 2 / 3].map((share) => this.readIn(window, window.from + share * (window.to - window.from))) as [Reading, Reading];
      this.cursors = [a, b];
    }
    this.cursorButton.setAttribute("aria-pressed", String(this.cursors !== undefined));
    this.moved();
  }

  private readIn(samples: Samples, time: number, of = this.plots[0]?.stream ?? ""): Reading {
    return readAt(samples, columnsOf(this.cockpit.store), time, of);
  }

  /** What a cursor stands at is read once and stays, whatever is drawn afterwards. */
  private setCursor(which: 0 | 1, time: number, of: string): void {
    if (!this.cursors || !this.shownWindow) return;
    this.cursors[which] = this.readIn(this.shownWindow, time, of);
    this.moved(of);
  }

  private moved(of?: string): void {
    this.stretch.clear();
    const placed = ++this.placed;
    clearTimeout(this.restTimer);
    if (this.cursors) this.restTimer = setTimeout(() => void this.settle(placed, of), REST_MS);
    this.invalidate();
    this.writeMeasures();
  }

  /** Read the cursors among all samples, where spans were drawn, and measure between them. */
  private async settle(placed: number, of: string | undefined): Promise<void> {
    const { document, store } = this.cockpit;
    const { cursors } = this;
    if (!cursors) return;
    const live: Samples = { ring: (stream) => store.rings.get(stream), width: 0 };
    const read = async (from: number, to: number): Promise<Samples | undefined> => {
      if (!document.isThere) return live;
      const part = await document.samples(Math.max(0, from), Math.min(document.length, to));
      return typeof part === "string" ? undefined : { ring: (stream) => part.rings.get(stream), width: 0 };
    };
    for (const which of [0, 1] as const) {
      const { time, isExact } = cursors[which];
      const samples = isExact ? undefined : await read(time - AROUND, time + AROUND);
      if (placed !== this.placed) return;
      if (samples) cursors[which] = this.readIn(samples, time, of);
    }
    const [from, to] = cursors.map(({ time }) => time).sort((a, b) => a - b) as [number, number];
    const { whole } = document;
    const spans = whole && { ring: (stream: string) => whole.rings.get(stream), width: whole.width };
    const samples = to - from <= LONGEST_STRETCH ? await read(from, to) : spans;
    if (placed !== this.placed || !samples) return;
    for (const [stream, columns] of columnsOf(store)) columns.forEach((name, i) => this.stretch.set(`${stream}.${name}`, measure(samples, stream, i, from, to)));
    this.invalidate();
    this.writeMeasures();
  }

  /** The time that is shown: up to now of a running rig, around the playhead of a recording. */
  private windowAt(now: number): Window | undefined {
    const { store, document } = this.cockpit;
    if (document.isThere) {
      const { length } = document;
      const at = document.at(now);
      const span = Math.min(this.span, length) || 1;
      const from = Math.min(Math.max(0, at - span / 2), Math.max(0, length - span));
      const part = document.between(from, from + span);
      const moments = (document.about?.moments ?? []).filter(({ kind }) => kind !== "node").map(({ t_s }) => t_s);
      return { age: () => 0, from, to: from + span, zero: 0, now: at, cursors: this.cursorTimes, moments, width: part?.width ?? 0, ring: (stream) => part?.rings.get(stream) };
    }
    // time goes on although nothing comes: what is missing shows as missing
    const head = this.playhead.advance(Math.max(store.newest, store.freshness.newest(now) - OLD_S), now, 1);
    const to = this.pausedAt ?? head;
    if (!Number.isFinite(to)) return undefined;
    const age = (stream: string): number => (this.pausedAt === undefined && (store.isPictureOld || store.isOld(stream)) ? store.age_s(stream) : 0);
    return { age, from: to - this.span, to, zero: to, now: undefined, cursors: this.cursorTimes, moments: [], width: 0, ring: (stream: string): Ring | undefined => store.rings.get(stream) };
  }

  private get cursorTimes(): [number, number] | undefined {
    return this.cursors && [this.cursors[0].time, this.cursors[1].time];
  }

  private build(): void {
    this.plots.forEach((plot) => plot.destroy());
    this.seen.disconnect();
    if (!this.cockpit.store.streams.size) {
      this.plots = [];
      this.grid.style.setProperty("--across", "1");
      this.grid.replaceChildren(make("p", { class: "empty" }, "The curves come with the connection: the line at the top says what it waits for."));
      return;
    }
    this.plots = this.specs.map((spec) => new Plot(spec, this.cockpit.store));
    const count = this.enlarged >= 0 ? 1 : this.specs.length;
    this.grid.style.setProperty("--across", String(count <= 1 ? 1 : count <= 2 || count === 4 ? 2 : 3));
    this.grid.replaceChildren(...this.plots.map((plot, i) => this.frameOf(plot, i)));
    for (const [i, child] of [...this.grid.children].entries()) {
      (child as HTMLElement).hidden = this.enlarged >= 0 && i !== this.enlarged;
      this.seen.observe(child);
    }
    this.plots.forEach((plot) => plot.resize());
    this.fitNames();
    this.layouts.keep(this.layout, this.specs);
    this.invalidate();
  }

  private frameOf(plot: Plot, i: number): HTMLElement {
    const keys = plot.keys.map(({ label, short, colour: token, isDashed }) => {
      const key = make("span", { class: "key", title: label }, make("span", { class: "long" }, label), make("span", { class: "short" }, short));
      key.style.setProperty("--key", `var(--${token})`);
      key.toggleAttribute("data-dashed", isDashed);
      return key;
    });
    const { title } = plot.spec;
    const enlarge = make("button", { type: "button", class: "enlarge", title: "Enlarge, or all of them", "aria-label": `Enlarge ${title}`, "aria-pressed": String(this.enlarged === i), onclick: () => this.enlarge(i) }, "⤢");
    const more = make("button", { type: "button", class: "more", title: "Curves, range, spectrum, place", "aria-label": `Change ${title}`, onclick: () => this.openSheet(i) }, "⋯");
    const name = make("div", { class: "name", draggable: "true" }, make("div", { class: "words" }, make("b", {}, title), make("span", { class: "keys" }, ...keys)), enlarge, more);
    const element = make("div", { class: "plot", role: "group", "aria-label": plot.title }, name, plot.area);
    plot.onHover = (time) => this.plots.forEach((other) => other.hover(time));
    plot.onTime = (time, begins) => this.place(time, begins, plot.stream);
    plot.area.addEventListener("keydown", (event) => this.moveByKey(event, plot.stream));
    this.makeDraggable(element, name, i);
    return element;
  }

  /** Give each scope its title and its keys in one line: the longest words that there is room for, or swatches alone. */
  private fitNames(): void {
    for (const words of this.grid.querySelectorAll<HTMLElement>(".words")) {
      for (const form of ["long", "short", "none"]) {
        words.dataset["form"] = form;
        if (words.scrollWidth <= words.clientWidth) break;
      }
    }
  }

  /** Dropped on the left third of a scope it goes before it, elsewhere both are drawn in one. */
  private makeDraggable(element: HTMLElement, name: HTMLElement, i: number): void {
    const place = (event: DragEvent): string => (event.clientX - element.getBoundingClientRect().left < element.clientWidth / 3 ? "before" : "onto");
    name.addEventListener("dragstart", (event) => {
      this.dragged = i;
      event.dataTransfer?.setData("text/plain", this.specs[i]!.title);
    });
    element.addEventListener("dragover", (event) => {
      if (this.dragged < 0 || this.dragged === i) return;
      event.preventDefault();
      element.dataset["over"] = place(event);
    });
    for (const end of ["dragleave", "dragend"]) element.addEventListener(end, () => delete element.dataset["over"]);
    element.addEventListener("drop", (event) => {
      event.preventDefault();
      const from = this.dragged;
      this.dragged = -1;
      delete element.dataset["over"];
      if (from < 0 || from === i) return;
      if (place(event) === "before") this.change(moved(this.specs, from, i));
      else this.overlay(from, i);
    });
  }

  private overlay(from: number, onto: number): void {
    const [one, other] = [this.specs[from], this.specs[onto]];
    if (!one || !other) return;
    const both = overlaid(this.specs, from, onto);
    const found = both[from < onto ? onto - 1 : onto]!;
    const units = new Set(found.curves.map((curve) => drawnAs(this.cockpit.store, curve).unit));
    if (one.kind === "distance" || other.kind === "distance" || units.size > 2) this.cockpit.commands.show("overlay", false, "a scope has two axes: not more than two units, and no distance");
    else this.change(both);
  }

  private change(specs: ScopeSpec[]): void {
    this.specs = specs;
    this.enlarged = -1;
    this.build();
  }

  private enlarge(i: number): void {
    this.enlarged = this.enlarged === i ? -1 : i;
    this.build();
    this.grid.querySelectorAll<HTMLElement>(".enlarge")[i]?.focus();
  }

  private openSheet(i: number): void {
    this.closeSheet();
    const spec = this.specs[i];
    if (!spec) return;
    const again = (at: number): void => this.openSheet(Math.min(this.specs.length - 1, Math.max(0, at)));
    this.sheet = sheetOf(this.cockpit.store, spec, {
      change: (changed) => {
        const focus = document.activeElement?.id;
        this.change(this.specs.map((found, at) => (at === i ? changed : found)));
        again(i);
        if (focus) document.getElementById(focus)?.focus();
      },
      move: (by) => {
        const to = i + by;
        if (to < 0 || to >= this.specs.length) return;
        this.change(moved(this.specs, i, by < 0 ? to : to + 1));
        again(to);
      },
      overlay: () => {
        if (i > 0) this.overlay(i, i - 1);
        this.closeSheet();
      },
      remove: () => {
        if (this.specs.length > 1) this.change(this.specs.filter((_, at) => at !== i));
        this.closeSheet();
      },
      close: () => {
        this.closeSheet();
        this.grid.querySelectorAll<HTMLElement>(".more")[i]?.focus();
      },
    });
    this.root.append(this.sheet);
    this.sheet.querySelector<HTMLElement>("#scope-close")?.focus();
  }

  private closeSheet(): void {
    this.sheet?.remove();
    this.sheet = undefined;
  }

  private add(): void {
    this.change([...this.specs, { title: "Scope", kind: "time", curves: [{ stream: "tip", column: "force" }], range: null }]);
    this.openSheet(this.specs.length - 1);
  }

  private take(name: string): void {
    this.layout = name;
    this.closeSheet();
    this.change(this.layouts.get(name));
    this.fillLayouts();
  }

  /** The first press asks for a name, the second saves under it. */
  private saveLayout(): void {
    if (this.layoutName.hidden) {
      this.layoutName.hidden = false;
      this.layoutName.value = this.layouts.isOwn(this.layout) ? this.layout : "";
      this.layoutName.focus();
      return;
    }
    const name = this.layoutName.value.trim();
    this.layoutName.hidden = true;
    if (!name) return;
    if (name in BUILT_IN) {
      this.cockpit.commands.show("layout", false, `${name} is one that every page has: take another name`);
      return;
    }
    this.layouts.save(name, this.specs);
    this.layout = name;
    this.layouts.keep(name, this.specs);
    this.fillLayouts();
  }

  private removeLayout(): void {
    this.layouts.remove(this.layout);
    this.take("Loop");
  }

  private fillLayouts(): void {
    this.layoutSelect.replaceChildren(...this.layouts.names.map((name) => make("option", { value: name, selected: name === this.layout }, name)));
    this.layoutRemove.hidden = !this.layouts.isOwn(this.layout);
  }

  private fillSpans(): void {
    const { document } = this.cockpit;
    const spans = SPANS.filter((span) => (document.isThere ? span < document.length : span <= LONGEST_LIVE && span >= 0.5));
    const rows: [number, string][] = spans.map((span) => [span, span < 60 ? `${span} s` : `${span / 60} min`]);
    if (document.isThere) rows.push([Math.max(1, document.length), "whole"]);
    if (!rows.some(([span]) => span === this.span)) this.span = rows.findLast(([span]) => span <= 10)?.[0] ?? rows.at(-1)![0];
    this.spanSelect.replaceChildren(...rows.map(([span, text]) => make("option", { value: span, selected: span === this.span }, text)));
  }

  /** Press near a cursor to take it along; in a recording without cursors the playhead goes there. */
  private place(time: number, begins: boolean, of: string): void {
    const { document } = this.cockpit;
    if (!this.cursors) {
      if (document.isThere && begins) document.seek(time);
      return;
    }
    if (begins) this.moving = Math.abs(time - this.cursors[0].time) <= Math.abs(time - this.cursors[1].time) ? 0 : 1;
    this.setCursor(this.moving, time, of);
  }

  /** Arrow keys move cursor A, with Shift cursor B, by at least a sample. */
  private moveByKey(event: KeyboardEvent, of: string): void {
    const direction = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (!this.cursors || !direction || !this.shownWindow) return;
    event.preventDefault();
    event.stopPropagation();
    const step = (this.shownWindow.to - this.shownWindow.from) * CURSOR_STEP;
    const which = event.shiftKey ? 1 : 0;
    const { time } = this.cursors[which];
    const next = neighbour(this.shownWindow.ring(of), time, direction);
    this.setCursor(which, direction > 0 ? Math.max(next, time + step) : Math.min(next, time - step), of);
  }

  private writeMeasures(): void {
    this.measures.hidden = !this.cursors;
    if (!this.cursors || !this.shownWindow) return;
    const [a, b] = this.cursors;
    const zero = this.cockpit.document.isThere ? 0 : this.shownWindow.zero;
    const number = (value: number, floor = 0): string => (Number.isNaN(value) ? "–" : `${Math.abs(value) < floor / 100 ? 0 : +value.toPrecision(4)}`);
    const times = [a.time - zero, b.time - zero, b.time - a.time].map((time, i) => `${i === 2 || [a, b][i]!.isExact ? "" : "≈ "}${fixed(time, 3)} s`);
    const between = a.time === b.time ? "" : `1 / (B − A) = ${number(1 / Math.abs(b.time - a.time))} Hz`;
    const shown = this.enlarged >= 0 ? this.plots.slice(this.enlarged, this.enlarged + 1) : this.plots;
    const rows = shown.flatMap((plot) =>
      plot.measured.flatMap(({ name, drawn: { label, unit, scale, floor } }) => {
        const [at, then] = [a, b].map((reading) => (reading.values.get(name) ?? NaN) * scale) as [number, number];
        if (Number.isNaN(at) && Number.isNaN(then)) return [];
        const found = this.stretch.get(name);
        const [peakToPeak, mean] = [found?.peakToPeak ?? NaN, found?.mean ?? NaN].map((value) => value * scale) as [number, number];
        // what does not go further than noise turns at no frequency
        const hertz = peakToPeak > floor ? (found?.hertz ?? NaN) : NaN;
        return [[`${label}, ${unit}`, number(at, floor), number(then, floor), number(then - at, floor), number(peakToPeak, floor), number(mean, floor), Number.isNaN(hertz) ? "–" : `${+hertz.toPrecision(3)} Hz`]];
      }),
    );
    const lines = [["time", ...times, between, "", ""], ...rows];
    const text = JSON.stringify(lines);
    if (this.measures.dataset["text"] === text) return;
    this.measures.dataset["text"] = text;
    const cells = (texts: readonly string[]): HTMLElement[] => texts.map((cell, i) => (i ? make("td", {}, cell) : make("th", { scope: "row" }, cell)));
    this.measures.replaceChildren(
      make("table", {}, make("thead", {}, make("tr", {}, ...HEADS.map((head) => make("th", { scope: "col" }, head)))), make("tbody", {}, ...lines.map((line) => make("tr", {}, ...cells(line))))),
    );
  }

  private async saveSamples(): Promise<void> {
    const window = this.shownWindow;
    if (!window) return;
    const { document, commands } = this.cockpit;
    const [from, to] = [document.chosen[0] ?? window.from, document.chosen[1] ?? window.to];
    if (!document.isThere) {
      save("telenano-scopes.csv", new Blob([this.csv(from, to, (stream) => this.cockpit.store.rings.get(stream))], { type: "text/csv" }));
      return;
    }
    const part = await document.samples(from, to);
    if (typeof part === "string") commands.show("save the samples", false, part);
    else save(`telenano-${fixed(from, 3)}-${fixed(to, 3)}s.csv`, new Blob([this.csv(from, to, (stream) => part.rings.get(stream))], { type: "text/csv" }));
  }

  /** Every sample of a stretch, in SI units: when the times begin, then a block of lines for each stream. */
  private csv(from: number, to: number, ringOf: (stream: string) => Ring | undefined): string {
    const { store, document } = this.cockpit;
    const origin = document.isThere ? (document.about?.start_ns ?? 0) : store.originNs;
    const lines = ["stream,time_s,column,value,unit", `session,0.000000,t_ns,${origin},ns`];
    for (const name of store.rings.keys()) {
      const ring = ringOf(name);
      const columns = store.streams.get(name)?.columns ?? [];
      if (!ring) continue;
      for (let i = ring.indexAt(from); i < ring.length && ring.time(i) <= to; i++) {
        columns.forEach((column, c) => {
          const value = ring.value(c, i);
          if (!Number.isNaN(value)) lines.push(`${name},${fixed(ring.time(i), 6)},${column.name},${value},${column.unit}`);
        });
      }
    }
    return `${lines.join("\n")}\n`;
  }

  private savePicture(): void {
    const shown = this.plots.filter((_, i) => this.enlarged < 0 || i === this.enlarged);
    const pictures = shown.map((plot) => plot.picture());
    const across = shown.length > 1 ? 2 : 1;
    const ratio = devicePixelRatio;
    const head = 24 * ratio;
    const [width, height] = [Math.max(...pictures.map((p) => p.width)), Math.max(...pictures.map((p) => p.height)) + head];
    const sheet = make("canvas", { width: across * width, height: Math.ceil(shown.length / across) * height });
    const pen = sheet.getContext("2d")!;
    pen.fillStyle = colour("panel");
    pen.fillRect(0, 0, sheet.width, sheet.height);
    pictures.forEach((picture, i) => {
      const [x, y] = [(i % across) * width, Math.floor(i / across) * height];
      pen.font = `600 ${12 * ratio}px system-ui`;
      pen.fillStyle = colour("text");
      pen.fillText(shown[i]!.title, x + 8 * ratio, y + 16 * ratio);
      let left = x + 20 * ratio + pen.measureText(shown[i]!.title).width;
      pen.font = `${11 * ratio}px system-ui`;
      for (const { label, colour: token } of shown[i]!.keys) {
        pen.fillStyle = colour(token);
        pen.fillText(label, left, y + 16 * ratio);
        left += pen.measureText(label).width + 10 * ratio;
      }
      pen.drawImage(picture, x, y + head);
    });
    sheet.toBlob((blob) => blob && save("telenano-scopes.png", blob));
  }
}
