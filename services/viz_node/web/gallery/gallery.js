// What a delay does to a law: one slider, four pictures. The page of `telenano view` and the static page use this file.

const WORDS = {
  nyquist: ["Nyquist curve of the loop", "Follow the curve to higher frequencies: the loop is stable as long as −1 stays on its left. Delay turns each point clockwise, by its frequency times the delay."],
  roots: ["Roots of the closed loop", "Each root is a motion that grows where it lies right of zero. With more delay roots come from the left and cross."],
  force: ["Force at the tip, scaled to the hand", "The hand presses with 1 N. The course is that of the law's own steps."],
  energy: ["Energy that the two-port holds", "What the hand put in, less what the tip was given. Below zero the law has made energy."],
};
const NOT_LINEAR = "This law is not linear, so that it has no Nyquist curve and no roots. Its energy says whether it is passive.";
const VIEWS = {
  nyquist: { x: [-2.5, 1.5], y: [-2.5, 1.5], across: "real part", up: "imaginary part", square: true },
  roots: { x: [-100, 20], y: [-17, 17], across: "growth rate, 1/s", up: "frequency, Hz" },
  force: { x: [0, 3], y: [-1, 4], across: "time, s", up: "force, N" },
  energy: { x: [0, 3], y: [-1, 1], across: "time, s", up: "energy, mJ" },
};
const MOST_MJ = 20;
const [WIDTH, HEIGHT, LEFT, BOTTOM, TOP, RIGHT] = [380, 250, 44, 34, 8, 10];

/** Whole numbers that are each less the one before, as values. */
export function values(differences, unit) {
  let sum = 0;
  return differences.map((one) => (sum += one) * unit);
}

/** Ticks of an axis: some five of them, at 1, 2 or 5. */
export function ticks([low, high]) {
  const rough = (high - low) / 5;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((one) => one * power).find((one) => one >= rough * 0.99);
  const found = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i++) found.push(+(i * step).toPrecision(6));
  return found;
}

/** The place of a round trip in the list of those that were tried: the nearest one. */
export function nearest(delays, delay) {
  return delays.reduce((best, one, i) => (Math.abs(one - delay) < Math.abs(delays[best] - delay) ? i : best), 0);
}

function element(tag, attributes = {}, ...children) {
  const found = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) found.setAttribute(name, value);
  found.append(...children);
  return found;
}

function shape(tag, attributes, text) {
  const found = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) found.setAttribute(name, String(value));
  if (text !== undefined) found.textContent = text;
  return found;
}

/** One picture with its axes. */
class Picture {
  constructor(name) {
    this.view = VIEWS[name];
    const [title, words] = WORDS[name];
    this.svg = shape("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": title });
    this.words = element("p", { class: "gallery-words" }, words);
    this.root = element("figure", { class: "gallery-picture" }, element("figcaption", {}, title), this.svg, this.words);
    const clip = shape("clipPath", { id: `gallery-${name}` });
    const [left, bottom] = [this.x(this.view.x[0]), this.y(this.view.y[0])];
    clip.append(shape("rect", { x: left, y: TOP, width: this.x(this.view.x[1]) - left, height: bottom - TOP }));
    this.axes = shape("g", { class: "gallery-axes" });
    this.inner = shape("g", { "clip-path": `url(#gallery-${name})` });
    this.svg.append(clip, this.axes, this.inner);
    this.scale(this.view.y);
  }

  /** Draw the axes, with the picture from one value to another upwards. */
  scale(range) {
    this.view = { ...this.view, y: range };
    const [x, y] = [this.view.x.map((v) => this.x(v)), this.view.y.map((v) => this.y(v))];
    const { axes } = this;
    axes.replaceChildren();
    for (const at of ticks(this.view.x)) axes.append(shape("line", { x1: this.x(at), x2: this.x(at), y1: y[0], y2: y[1], class: at ? "" : "zero" }), shape("text", { x: this.x(at), y: y[0] + 14, "text-anchor": "middle" }, at));
    for (const at of ticks(this.view.y)) axes.append(shape("line", { x1: x[0], x2: x[1], y1: this.y(at), y2: this.y(at), class: at ? "" : "zero" }), shape("text", { x: x[0] - 5, y: this.y(at) + 4, "text-anchor": "end" }, at));
    axes.append(shape("text", { x: (x[0] + x[1]) / 2, y: HEIGHT - 4, "text-anchor": "middle" }, this.view.across));
    axes.append(shape("text", { x: 0, y: 0, transform: `translate(11 ${(y[0] + y[1]) / 2}) rotate(-90)`, "text-anchor": "middle" }, this.view.up));
  }

  x(value) {
    const [low, high] = this.view.x;
    // the same length for both directions of a plane
    const width = this.view.square ? HEIGHT - TOP - BOTTOM : WIDTH - LEFT - RIGHT;
    return LEFT + (this.view.square ? (WIDTH - LEFT - RIGHT - width) / 2 : 0) + ((value - low) / (high - low)) * width;
  }

  y(value) {
    const [low, high] = this.view.y;
    return HEIGHT - BOTTOM - ((value - low) / (high - low)) * (HEIGHT - TOP - BOTTOM);
  }

  line(xs, ys, kind) {
    const path = xs.map((x, i) => `${i ? "L" : "M"}${this.x(x).toFixed(1)} ${this.y(ys[i]).toFixed(1)}`).join("");
    this.inner.append(shape("path", { d: path, class: `gallery-line ${kind}` }));
  }

  dot(x, y, kind, radius = 4) {
    this.inner.append(shape("circle", { cx: this.x(x), cy: this.y(y), r: radius, class: kind }));
  }

  /** Begin anew; without a picture there are only words. */
  clear(words, isThere = true) {
    this.inner.replaceChildren();
    this.words.textContent = words;
    this.root.classList.toggle("is-empty", !isThere);
  }
}

/** The slider, the law and the pictures; `choose` sets them from outside. */
export class Gallery {
  constructor(root, data) {
    this.data = data;
    this.law = element("select", { "aria-label": "Law" }, ...data.laws.map(({ law }) => element("option", { value: law }, law.replaceAll("_", " "))));
    this.slider = element("input", { type: "range", min: 0, max: data.delays_ms.length - 1, step: 1, value: 0, "aria-label": "Round trip of the link" });
    this.delay = element("output", { class: "gallery-delay" });
    this.said = element("p", { class: "gallery-said", "aria-live": "polite" });
    this.pictures = Object.fromEntries(Object.keys(VIEWS).map((name) => [name, new Picture(name)]));
    const pictures = element("div", { class: "gallery-pictures" }, ...Object.values(this.pictures).map((one) => one.root));
    const condition = `A hand of constant force on a spring of ${data.stiffness_n_per_m} N/m, over a link with a constant delay.`;
    root.classList.add("gallery");
    root.append(element("div", { class: "gallery-bar" }, this.law, this.slider, this.delay), this.said, pictures, element("p", { class: "gallery-words" }, condition));
    this.slider.addEventListener("input", () => this.draw());
    this.law.addEventListener("change", () => this.draw());
    this.draw();
  }

  choose(law, delayMs) {
    if (this.data.laws.some((one) => one.law === law)) this.law.value = law;
    if (Number.isFinite(delayMs)) this.slider.value = String(nearest(this.data.delays_ms, delayMs));
    this.draw();
  }

  /** The round trip that is shown [ms]. */
  get delayMs() {
    return this.data.delays_ms[Number(this.slider.value)];
  }

  draw() {
    const about = this.data.laws.find(({ law }) => law === this.law.value);
    const place = Number(this.slider.value);
    const [cell, delay] = [about.cells[place], this.data.delays_ms[place]];
    const { nyquist, roots, force, energy } = this.pictures;
    const good = cell.verdict === "stable" ? "good" : "bad";
    this.delay.textContent = `${delay} ms`;
    this.slider.setAttribute("aria-valuetext", `${delay} ms round trip`);
    const bears = !about.linear ? "" : about.critical_ms === null ? " Theory: stable at any constant delay." : ` Theory: stable up to ${about.critical_ms.toFixed(1)} ms.`;
    this.said.replaceChildren(element("b", { class: good }, cell.verdict.replaceAll("_", " ")), `: ${cell.reason}.${bears}`);
    nyquist.clear(about.linear ? WORDS.nyquist[1] : NOT_LINEAR, about.linear);
    roots.clear(about.linear ? WORDS.roots[1] : NOT_LINEAR, about.linear);
    if (about.linear) {
      const [re, im] = cell.nyquist.map((part) => values(part, this.data.nyquist.unit));
      const circle = Array.from({ length: 73 }, (_, i) => (i * Math.PI) / 36);
      nyquist.line(circle.map(Math.cos), circle.map(Math.sin), "thin");
      nyquist.line(re, im.map((v) => -v), "thin");
      nyquist.line(re, im, good);
      nyquist.dot(-1, 0, "critical", 5);
      for (const [growth, omega] of cell.roots) for (const side of omega > 1e-6 ? [1, -1] : [1]) roots.dot(growth, (side * omega) / (2 * Math.PI), growth > 0 ? "bad" : "good");
    }
    force.clear(WORDS.force[1]);
    energy.clear(WORDS.energy[1]);
    const times = (series, { step_s }) => series.map((_, i) => i * step_s);
    const corners = [[0, 0], ...this.data.hand, [VIEWS.force.x[1], this.data.hand.at(-1)[1]]];
    force.line(corners.map(([t]) => t), corners.map(([, f]) => f), "thin");
    force.line(times(cell.force, this.data.force), values(cell.force, this.data.force.unit), good);
    const held = values(cell.energy, this.data.energy.unit);
    const most = ticks([0, 5 * Math.min(MOST_MJ, Math.max(0.05, ...held.map(Math.abs)))])[1];
    energy.scale([-most, most]);
    energy.line(times(cell.energy, this.data.energy), held, cell.lowest_mj < -0.001 ? "bad" : "good");
  }
}
