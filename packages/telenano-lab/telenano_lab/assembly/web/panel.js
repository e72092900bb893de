import { ACROSS_M, INSTRUMENT, colour, make as element } from "../../kit.js";
import { findParticles, isBlocked, SHORT, touchDistance, travelLeft } from "./particles.js";

const NM = 1e9;
const PROGRAM = "afm/program/slave";
const AFM = "afm/state/slave";
/** A particle has arrived within this share of its diameter. */
const DONE_SHARE = 0.1;
/** A lateral force above this is that of a particle [N]. */
const FELT_N = 2e-9;
const LOOK_MS = 100;
const LONGEST_PUSH_MS = 600_000;
/** A push goes as fast as a hand may (Eq. 14), so that a person can take over in the middle [m/s]. */
const PUSH_M_PER_S = 300e-9;
/** The motion of the tip is known after so much of it [nm]. */
const MOTION_NM = 3;

/** Particles in the last image, where they are believed to be now, their targets, and who pushes them: hand or program. */
class ParticlesPanel {
  root;
  cockpit;
  known = [];
  pushed;
  isAssembling = false;
  isTakenOver = false;
  /** The tip follows the hand that has taken over, as far as the nodes have acknowledged it. */
  isByHand = false;
  /** What the hand across is, as the nodes have acknowledged it. */
  chosen = "rate";
  words = "No image yet: Scan takes one, with its tip clear of the particles.";
  aside = NaN;
  before;
  motion;
  ran = "";
  drawn = "";
  list = element("ol", { id: "particles-list", "aria-label": "Particles in the last image" });
  state = element("p", { class: "quiet", id: "particles-state", role: "status" });
  left = element("meter", { id: "travel-left", min: 0, max: 3, low: SHORT, optimum: 3, "aria-label": "Travel left until the particle slips off, in distances of the axes" });
  leftText = element("span", { class: "quiet", id: "travel-left-text" });
  find = this.button("particles-find", "Find", () => this.look());
  assemble = this.button("assemble", "Assemble", () => void this.run());
  takeOver = this.button("take-over", "Take over", () => void this.take());
  giveBack = this.button("give-back", "Give back", () => void this.give());
  mode = element("select", { id: "lateral-mode", "aria-label": "What the hand across the sample is", onchange: () => void this.choose() }, ...["rate", "position"].map((name) => element("option", { value: name }, `hand is ${name === "rate" ? "velocity" : "place"}`)));
  switches = [
    this.toggle("lateral-clutch", "Clutch", "The hand moves freely and the tip stands", (on) => ({ "lateral.clutch": on ? "released" : "engaged" })),
    this.toggle("hold-depth", "Hold depth", "The hand stays at its depth", (on) => ({ "lateral.depth.enabled": on })),
    this.toggle("guide", "Guide", "The hand is drawn to the line from the pushed particle to its target", (on) => ({ "lateral.guide.enabled": on, ...this.line() })),
  ];
  pad = element("div", { class: "pad steer", id: "steer-pad", tabindex: 0, role: "application", "aria-label": "Hand across the sample: drag from the middle, or hold the arrow keys, to move the tip" });

  /** Whether an image was looked at since the page was opened. */
  hasLooked = false;
  /** Whether particles were on the image when it was last drawn. */
  wasMeant = false;

  constructor(root, cockpit) {
    this.root = root;
    this.cockpit = cockpit;
    const bar = element("div", { class: "row" }, element("span", { class: "quiet" }, "Travel left"), this.left, this.leftText);
    root.append(this.state, element("div", { class: "row" }, this.find, this.assemble, this.takeOver, this.giveBack), element("div", { class: "row" }, this.mode, ...this.switches), this.pad, bar, this.list);
    const { image, hand } = cockpit;
    image.onDraw = (pen, at, scale) => this.draw(pen, at, scale);
    image.onGrab = (x, y) => this.grab(x, y);
    image.onNext = () => this.cockpit.commands.may && this.next();
    image.nextText = () => (this.known.some(({ target }) => target) ? `Stick pressed: ${this.isByHand ? "give back" : this.isAssembling || this.isTakenOver ? "take over" : "assemble"}` : "");
    this.pad.addEventListener("pointerdown", (event) => {
      this.pad.setPointerCapture(event.pointerId);
      this.steer(event);
    });
    this.pad.addEventListener("pointermove", (event) => this.pad.hasPointerCapture(event.pointerId) && this.steer(event));
    for (const name of ["pointerup", "pointercancel", "lostpointercapture", "blur"]) this.pad.addEventListener(name, () => hand.steer(null));
    this.pad.addEventListener("keydown", (event) => hand.steerByKey(event.key) && event.preventDefault());
    this.pad.addEventListener("keyup", (event) => event.key.startsWith("Arrow") && hand.steer(null));
  }

  begin() {
    const may = this.cockpit.commands.may && this.cockpit.tip.isThere;
    for (const control of [this.assemble, this.takeOver, this.giveBack, this.mode, ...this.switches]) control.disabled = !may;
    this.pad.setAttribute("aria-disabled", String(!this.cockpit.hand.isOffered));
    this.pad.tabIndex = this.cockpit.hand.isOffered ? 0 : -1;
  }

  /** Keep up with images and pushes, whichever tab is shown. */
  frame() {
    const runs = this.cockpit.tip.program;
    if (this.ran === "scan" && !runs) this.look();
    this.ran = runs;
    this.follow();
    if (this.isMeant === this.wasMeant) return;
    this.wasMeant = this.isMeant;
    this.cockpit.image.redraw();
  }

  /** Whether somebody is about particles: their panel is open, one has a target, or one is pushed. The heights of any sample may look like some. */
  get isMeant() {
    return this.root.offsetParent !== null || this.pushed !== undefined || this.known.some(({ target }) => target);
  }

  write() {
    const { store, image, tip } = this.cockpit;
    const runs = tip.program;
    this.find.disabled = image.surface.isEmpty;
    // a page that is opened after a scan has its image, and has not seen the scan end
    if (!this.hasLooked && !image.surface.isEmpty && runs !== "scan") this.look();
    const program = store.state.get(PROGRAM);
    const own = runs === "push" ? String(program?.["text"] ?? "") : this.byHand();
    const sentence = [own, this.words].filter(Boolean).join(" · ");
    if (this.state.textContent !== sentence) this.state.textContent = sentence;
    const d = this.pushed ? touchDistance(this.pushed.radius) : NaN;
    const left = Number.isNaN(this.aside) || !this.pushed ? NaN : travelLeft(d, this.aside) / d;
    this.left.value = Number.isNaN(left) ? 0 : Math.min(3, left);
    const text = Number.isNaN(left) ? "–" : left > 3 ? "more than 3 d" : `${left.toFixed(1)} d`;
    if (this.leftText.textContent !== text) this.leftText.textContent = text;
    const rows = this.known.map((one) => {
      const target = one.target ? `, ${Math.hypot(one.target.x - one.x, one.target.y - one.y).toFixed(0)} nm from its target` : "";
      return `${one.x.toFixed(0)}, ${one.y.toFixed(0)} nm ± ${(2 * one.error).toFixed(1)}, radius ${one.radius.toFixed(0)}${target}${one.isLost ? ", lost: scan again" : one === this.pushed ? ", pushed" : ""}`;
    });
    if (rows.join() !== this.drawn) {
      this.drawn = rows.join();
      this.list.replaceChildren(...rows.map((row) => element("li", {}, row)));
      image.redraw();
    }
  }

  /** Find the particles of the image that is there; targets stay with those that are where they were. */
  look() {
    const { surface } = this.cockpit.image;
    const extent = surface.extent;
    if (!extent) return;
    this.hasLooked = true;
    const { measured, rows, columns } = surface.grid();
    const was = this.known;
    const found = findParticles({ values: measured, rows, columns, extent }).map((one) => {
      const same = was.find((other) => Math.hypot(other.x - one.x, other.y - one.y) < one.radius);
      return { ...one, found: [one.x, one.y], isLost: false, ...(same?.target && { target: same.target }) };
    });
    // an image of a part says nothing of what lies elsewhere
    const elsewhere = was.filter(({ x, y, radius }) => (Math.abs(x - extent.x) > extent.width / 2 || Math.abs(y - extent.y) > extent.depth / 2) && !found.some((one) => Math.hypot(one.x - x, one.y - y) < radius));
    this.known = [...found, ...elsewhere];
    this.pushed = undefined;
    this.cockpit.image.redraw();
    this.words = this.known.length ? `${found.length} particles found. Drag one in the flat image: that is its target.` : "No particle was found in the image.";
  }

  /** Take up where the pushed particle is: from the report of a push, or from the lateral force under a hand. */
  follow() {
    const { store, tip } = this.cockpit;
    const runs = tip.program;
    const [x, y] = [store.last("tip", "x") * NM, store.last("tip", "y") * NM];
    if (runs === "push") {
      const values = store.fact(PROGRAM, "values");
      if (values?.["in_contact"] !== true) return;
      const [bx, by] = [Number(values["believed_x_m"]) * NM, Number(values["believed_y_m"]) * NM];
      // a push that this page has not begun is that of a command or of a recording
      if (!this.isAssembling) this.pushed = this.known.find((one) => Math.hypot(bx - one.x, by - one.y) < one.radius);
      if (!this.pushed) return;
      this.believe(this.pushed, bx, by);
      this.aside = Number(values["aside_rad"]);
      return;
    }
    const [fx, fy] = [store.last("tip", "force_x"), store.last("tip", "force_y")];
    const size = Math.hypot(fx, fy);
    if (runs || !(size > FELT_N) || store.fact(AFM, "mode") !== "follow") {
      this.before = undefined;
      return;
    }
    const [ex, ey] = [-fx / size, -fy / size];
    const near = this.known.find((one) => Math.hypot(x + touchDistance(one.radius) * ex - one.x, y + touchDistance(one.radius) * ey - one.y) < one.radius);
    if (!near) return;
    this.pushed = near;
    const d = touchDistance(near.radius);
    this.before ??= [x, y];
    const [dx, dy] = [x - this.before[0], y - this.before[1]];
    const way = Math.hypot(dx, dy);
    if (way < MOTION_NM) return;
    this.motion = [dx / way, dy / way];
    this.before = [x, y];
    this.aside = Math.acos(Math.min(1, Math.max(-1, this.motion[0] * ex + this.motion[1] * ey)));
    // what is not seen grows by e^(s / d) in a straight push
    near.error *= Math.exp(way / d);
    this.believe(near, x + d * ex, y + d * ey);
  }

  believe(one, x, y) {
    [one.x, one.y] = [x, y];
    one.isLost = false;
    // the force tells the place again, so the error does not outgrow the particle
    one.error = Math.min(one.error, one.radius);
    this.cockpit.image.redraw();
  }

  /** What the hand does, in words; nothing where it does not move the tip. */
  byHand() {
    const { store, hand } = this.cockpit;
    if (!hand.meantAcross) return "";
    const size = Math.hypot(store.last("tip", "force_x"), store.last("tip", "force_y"));
    const news = store.events.findLast(({ src, text }) => src.startsWith("controller") && /^(met|lost): /.test(text));
    if (size > FELT_N) return `Pushing, ${(size * NM).toFixed(1)} nN`;
    return news?.text.startsWith("lost") ? "The particle is lost" : "Nothing is met yet";
  }

  /** Push each particle that has a target and is not there, the next one that nothing blocks. */
  async run() {
    if (this.isAssembling) return;
    this.isAssembling = true;
    this.isTakenOver = this.isByHand = false;
    while (!this.isTakenOver) {
      const open = this.known.filter((one) => one.target && !one.isLost && Math.hypot(one.target.x - one.x, one.target.y - one.y) > 2 * DONE_SHARE * one.radius);
      const next = open.find((one) => !isBlocked(one, one.target, this.known.filter((other) => other !== one)));
      if (!next) {
        const [lost, waits] = [this.known.filter((one) => one.isLost).length, open.length];
        this.words = lost ? `${lost} particles are lost: scan again.` : waits ? `${waits} particles are blocked by others: move those out of the way first.` : this.known.some((one) => one.target) ? "Every particle is at its target, as far as is known: scan to see." : "No particle has a target yet: drag one in the flat image.";
        break;
      }
      if (!(await this.push(next))) break;
    }
    this.isAssembling = false;
  }

  next() {
    void (this.isByHand ? this.give() : this.isAssembling || this.isTakenOver ? this.take() : this.run());
  }

  async push(one) {
    const { commands, store, tip } = this.cockpit;
    this.pushed = one;
    this.words = `Particle ${this.known.indexOf(one) + 1} of ${this.known.length}`;
    const [x0, y0, x1, y1, radius] = [one.x, one.y, one.target.x, one.target.y, one.radius].map((value) => value / NM);
    const keys = { program: "push", "push.x0_m": x0, "push.y0_m": y0, "push.x1_m": x1, "push.y1_m": y1, "push.radius_m": radius, "push.speed_m_per_s": PUSH_M_PER_S };
    if (!(await this.until(() => !tip.program && store.fact(AFM, "mode") !== "retracting"))) return false;
    if (!(await commands.command("push begins", "set", INSTRUMENT, keys))) return false;
    await this.until(() => tip.program === "push", 3000);
    await this.until(() => tip.program !== "push");
    const values = store.fact(PROGRAM, "values");
    const isThere = values?.["why"] === "the particle is at its goal";
    if (values?.["in_contact"] === true)
      this.believe(one, Number(values["believed_x_m"]) * NM, Number(values["believed_y_m"]) * NM);
    if (isThere) one.error = Math.hypot(one.error, Number(values?.["believed_error_m"] ?? 0) * NM);
    else if (!this.isTakenOver) {
      one.isLost = true;
      this.words = `The push ended: ${String(values?.["why"] || store.fact(PROGRAM, "text"))}.`;
    }
    return isThere;
  }

  /** Let the hand go on where the program is: the tip comes up, and down again at the same place. */
  async take() {
    this.isTakenOver = true;
    this.words = "The program ends, and the tip comes up.";
    this.isByHand = await this.cockpit.tip.followHand();
    this.words = this.isByHand ? "By hand: press down with Keep holding, and steer across." : "The tip does not follow the hand: take over again.";
    if (this.isByHand)
      await this.set({ "lateral.mode": this.mode.value, "lateral.clutch": "engaged", ...this.line() });
  }

  /** Let the program go on from where the particles are believed to be now. */
  async give() {
    const { hand, tip } = this.cockpit;
    hand.letGo();
    await this.until(() => !this.isAssembling && !tip.program, 3000);
    await this.run();
  }

  /** The guide from where the pushed particle, or the nearest with a target, is to where it is to go. */
  line() {
    const one = this.pushed ?? this.known.find(({ target }) => target);
    if (!one?.target) return {};
    return { "lateral.guide.x0_m": one.x / NM, "lateral.guide.y0_m": one.y / NM, "lateral.guide.x1_m": one.target.x / NM, "lateral.guide.y1_m": one.target.y / NM };
  }

  /** Choose what the hand across is; the list shows again what it was where that is refused. */
  async choose() {
    const wanted = this.mode.value;
    if (await this.set({ "lateral.mode": wanted })) this.chosen = wanted;
    else this.mode.value = this.chosen;
  }

  async set(values) {
    return this.cockpit.commands.command("hand across the sample", "set", "controller", values);
  }

  async until(holds, longest_ms = LONGEST_PUSH_MS) {
    for (let waited = 0; waited < longest_ms; waited += LOOK_MS) {
      if (holds()) return true;
      await new Promise((go) => setTimeout(go, LOOK_MS));
    }
    return holds();
  }

  steer(event) {
    const { clientWidth: width, clientHeight: height } = this.pad;
    const box = this.pad.getBoundingClientRect();
    const side = Math.min(width, height) / 2;
    this.cockpit.hand.steer([(ACROSS_M * (event.clientX - box.left - width / 2)) / side, (-ACROSS_M * (event.clientY - box.top - height / 2)) / side]);
  }

  /** Begin to drag the target of the particle at a place; none where there is no particle or target. */
  grab(x, y) {
    const one = this.known.find((other) => Math.hypot(other.x - x, other.y - y) < other.radius || (other.target && Math.hypot(other.target.x - x, other.target.y - y) < other.radius));
    if (!one || !this.cockpit.commands.may || !this.isMeant) return undefined;
    return (toX, toY) => {
      one.target = { x: toX, y: toY };
      this.cockpit.image.redraw();
    };
  }

  draw(pen, at, scale) {
    if (!this.isMeant) return;
    const ring = (x, y, radius) => {
      pen.beginPath();
      pen.arc(...at(x, y), radius * scale, 0, 7);
    };
    for (const one of this.known) {
      if (Math.hypot(one.x - one.found[0], one.y - one.found[1]) > one.radius) {
        pen.fillStyle = "rgba(128, 128, 128, 0.75)";
        ring(...one.found, one.radius * 1.3);
        pen.fill();
      }
      pen.lineWidth = one === this.pushed ? 3 : 2;
      pen.strokeStyle = one.isLost ? colour("bad") : "#ffffff";
      pen.setLineDash(one.isLost ? [3, 3] : []);
      ring(one.x, one.y, one.radius);
      pen.stroke();
      pen.strokeStyle = colour("c2");
      ring(one.x, one.y, Math.max(2 * one.error, 2 / scale));
      pen.stroke();
      if (!one.target) continue;
      pen.setLineDash([5, 4]);
      pen.strokeStyle = colour("accent");
      pen.beginPath();
      pen.moveTo(...at(one.x, one.y));
      pen.lineTo(...at(one.target.x, one.target.y));
      pen.stroke();
      ring(one.target.x, one.target.y, one.radius);
      pen.stroke();
      pen.setLineDash([]);
    }
    pen.setLineDash([]);
  }

  button(id, text, action) {
    return element("button", { type: "button", id, onclick: action }, text);
  }

  toggle(id, text, title, values) {
    const button = element("button", { type: "button", id, title, "aria-pressed": "false" }, text);
    button.addEventListener("click", () => {
      const on = button.getAttribute("aria-pressed") !== "true";
      void this.set(values(on)).then((done) => done && button.setAttribute("aria-pressed", String(on)));
    });
    return button;
  }
}

export const make = (root, cockpit) => new ParticlesPanel(root, cockpit);
