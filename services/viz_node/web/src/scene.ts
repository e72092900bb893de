import {
  AmbientLight,
  Color,
  DirectionalLight,
  GridHelper,
  Group,
  Mesh,
  MeshStandardMaterial,
  MOUSE,
  PerspectiveCamera,
  PlaneGeometry,
  Raycaster,
  RingGeometry,
  Scene,
  SphereGeometry,
  Vector2,
  Vector3,
  WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { AnaglyphEffect } from "three/addons/effects/AnaglyphEffect.js";
import { StereoEffect } from "three/addons/effects/StereoEffect.js";
import { gradient } from "./colormap";
import { colour, make, part, quantity } from "./dom";
import { Flat } from "./flat";
import { Headset } from "./headset";
import { drawsInSoftware, Pace } from "./pace";
import { Probe } from "./probe";
import type { Line } from "./protocol";
import { Section } from "./section";
import { Sheet } from "./sheet";
import { arrow, axesAndBars, empty, niceLength, point, type Extent } from "./shapes";
import type { Store } from "./store";
import { Surface } from "./surface";
import { fixed } from "./numbers";

/** What the pointer does in the scene. */
export type Tool = "press" | "turn" | "place" | "profile";
/** What of the surface is shown: in three dimensions, flat, or both beside each other. */
type Shown = "solid" | "both" | "flat";
type Stereo = "off" | "anaglyph" | "side by side";

const NM = 1e9;
const PLANE_NM = 120;
/** How much more the cantilever is bent in the picture than in the instrument. */
const DEFLECTION_FACTOR = 5;
const ARROW_NM = 34;
/** How much higher than measured heights may be drawn. */
const STRETCHES = [1, 2, 5, 10, 20, 50, 100];
/** Distance of the eyes in that to what they look at: 64 mm at 1.6 m. */
const EYE_SHARE = 0.04;
/** A change of this much is seen: half a pixel of a picture of usual size. */
const SEEN_NM = 0.2;
/** Distance of the eye, in that at which a window of usual shape shows the sample; and that for its width. */
const NEAREST = 1.08;
const NEAREST_WIDE = 1.95;
const AFM = "afm/state/slave";
/** Where frames are slow the picture is drawn in one of this many, and the rest stays usable. */
const SLOW_SHARE = 6;

/** Tip, cantilever and surface, in nanometres, z away from the sample. */
export class View {
  readonly headset: Headset;
  readonly section: Section;
  readonly flat: Flat;
  /** What the pointer does: the one that is pressed. */
  tool: Tool = "turn";
  private readonly tools: Record<Tool, HTMLButtonElement> = {
    press: this.toolButton("press", "tool-press", "Press", "Press and drag down in the scene: the virtual hand pushes the tip (right button turns)"),
    turn: this.toolButton("turn", "tool-turn", "Turn", "Drag turns the scene"),
    place: this.toolButton("place", "place-tip", "Move tip", "Click, and the tip moves over the sample to the pointer"),
    profile: this.toolButton("profile", "section", "Profile", "Drag a line over the surface to see the heights along it"),
  };
  /** Called with a place on the sample [nm]. */
  onPlace: (x: number, y: number) => void = () => {};
  /** Called where the tool presses: how far down the pointer went, in heights of the scene; null when it is let go. */
  onPress: (down: number | null) => void = () => {};
  /** What the tag beside the pointer says while it presses. */
  pressText: () => string = () => "";
  frames = 0;
  private cost = 0;
  private dirty = true;
  private readonly pace = new Pace(SLOW_SHARE);
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly camera = new PerspectiveCamera(40, 1, 1, 4000);
  private readonly orbit: OrbitControls;
  /** Whether somebody has chosen from where to look: then a window of another shape is looked into from there. */
  private isTurned = false;
  private readonly world = new Group();
  private readonly tip = new Probe();
  private readonly normal = arrow(colour("tip"));
  private readonly lateral = arrow(colour("lateral"));
  private readonly contact: Mesh;
  private readonly plane: Mesh<PlaneGeometry, MeshStandardMaterial>;
  private grid: GridHelper;
  private readonly mark: Mesh;
  private readonly note = make("div", { class: "note" });
  private readonly ends = make("div", { class: "ends" });
  private readonly ramp = make("div", { class: "ramp" });
  private readonly legend = make("div", { class: "legend", hidden: true }, this.ramp, this.ends);
  private readonly tag = make("div", { class: "tag", hidden: true });
  private readonly solid = make("div", { class: "solid" });
  private readonly views = make("div", { class: "views" });
  private readonly showButtons = (["solid", "both", "flat"] as const).map((name) => make("button", { type: "button", id: `show-${name}`, "aria-pressed": String(name === "solid"), onclick: () => this.show(name, true) }, { solid: "3-D", both: "Both", flat: "Flat" }[name]));
  private isShownByChoice = false;
  private anaglyph: AnaglyphEffect | undefined;
  private sideBySide: StereoEffect | undefined;
  private stereo: Stereo = "off";
  private greatestForce = 1e-9;
  private readonly bars = new Group();
  private readonly stretchSelect = make(
    "select",
    { id: "stretch", "aria-label": "Exaggeration of heights", onchange: () => this.setStretch(Number(this.stretchSelect.value)) },
    ...STRETCHES.map((factor) => make("option", { value: factor }, `Heights × ${factor}`)),
  );
  private stretch = 1;
  /** What was drawn last, in steps that can be seen: the same is not drawn again. */
  private pose = "";
  /** Middle and sides of what is shown [nm]: the camera, the tip and the bars go by it. */
  private extent: Extent = { x: 0, y: 0, width: 0, depth: 0 };
  private picked = "";
  private markHeight = 0;
  private readonly raycaster = new Raycaster();
  private readonly sheet = new Sheet();
  /** What the stick of a controller does next, in words. */
  nextText: () => string = () => "";

  constructor(
    private readonly root: HTMLElement,
    private readonly store: Store,
    readonly surface: Surface,
  ) {
    this.section = new Section(surface);
    this.flat = new Flat(surface, this.section, () => [this.store.last("tip", "x") * NM, this.store.last("tip", "y") * NM]);
    const isSoftware = drawsInSoftware();
    this.renderer = new WebGLRenderer({ antialias: !isSoftware });
    this.renderer.setPixelRatio(isSoftware ? 1 : Math.min(2, devicePixelRatio));
    this.renderer.domElement.setAttribute("role", "img");
    this.renderer.domElement.setAttribute("aria-label", "Tip, cantilever and surface in three dimensions");
    this.solid.append(this.renderer.domElement);
    this.scene.add(new AmbientLight(0xffffff, 0.9), this.world);
    const sun = new DirectionalLight(0xffffff, 1.9);
    sun.position.set(-60, 160, 90);
    this.scene.add(sun);
    // the world has z up, the library y
    this.world.rotation.x = -Math.PI / 2;
    this.plane = new Mesh(new PlaneGeometry(PLANE_NM, PLANE_NM), new MeshStandardMaterial({ roughness: 0.9, transparent: true, opacity: 0.92 }));
    this.grid = new GridHelper();
    this.contact = new Mesh(new RingGeometry(3.5, 5.5, 40), new MeshStandardMaterial({ emissiveIntensity: 0.5 }));
    this.mark = new Mesh(new SphereGeometry(0.9), new MeshStandardMaterial({ color: 0xffb000, emissive: 0xffb000 }));
    this.mark.visible = false;
    this.world.add(this.plane, this.surface.mesh, this.tip, this.contact, this.mark, this.normal, this.lateral);
    this.world.add(this.bars, this.sheet.mesh);
    this.sheet.mesh.visible = false;
    this.orbit = new OrbitControls(this.camera, this.renderer.domElement);
    this.orbit.enableDamping = false;
    this.orbit.addEventListener("change", () => this.invalidate());
    this.orbit.addEventListener("start", () => (this.isTurned = true));
    this.orbit.listenToKeyEvents(this.renderer.domElement);
    this.renderer.domElement.tabIndex = 0;
    this.headset = new Headset(this.renderer, this.scene, this.world, (text) => this.say(text));
    this.headset.onLeave = () => this.resize();
    this.headset.size = () => this.size;
    this.world.add(this.section.polyline);
    this.buildOverlay();
    this.fit({ x: 0, y: 0, width: PLANE_NM, depth: PLANE_NM });
    this.recolour();
    new ResizeObserver(() => this.resize()).observe(this.solid);
    this.resize();
    // the distance goes by the shape of the window
    this.reset();
    this.renderer.setAnimationLoop(() => this.draw());
    this.renderer.domElement.addEventListener("dblclick", (event) => this.pick(event));
    this.section.onChange = () => {
      this.invalidate();
      this.flat.invalidate();
    };
    this.flat.onPlace = (x, y) => this.tool === "place" && this.onPlace(x, y);
    this.flat.tool = () => this.tool;
    this.setTool("turn");
    this.renderer.domElement.addEventListener("pointerdown", (event) => this.beginDrag(event), { capture: true });
  }

  /** Draw again: something has changed. Nothing is drawn otherwise, so a page that rests costs nothing. */
  invalidate(): void {
    this.dirty = true;
  }

  /** Draw again if the new samples moved, bent or loaded the tip so far that it can be seen. */
  follow(): void {
    const of = (column: string): number => this.store.last("tip", column);
    const side = this.size;
    const steps = [of("x"), of("y"), of("base"), of("separation"), of("deflection") * DEFLECTION_FACTOR].map((m) => Math.round((m * NM) / (SEEN_NM * side)));
    const forces = ["force", "force_x", "force_y"].map((column) => Math.round((of(column) / this.greatestForce) * (ARROW_NM / SEEN_NM)));
    const pose = [...steps, ...forces, this.store.fact(AFM, "in_contact"), this.store.fact(AFM, "meniscus")].join();
    if (pose === this.pose) return;
    this.pose = pose;
    this.invalidate();
  }

  /** Draw heights, and the distance of the tip from them, this many times as high as measured. */
  setStretch(factor: number): void {
    this.stretch = factor;
    this.buildBars();
    this.invalidate();
  }

  addLines(lines: Line[]): void {
    if (!this.isShownByChoice && this.root.clientWidth > 640) this.show("both");
    for (const line of lines) this.surface.add(line);
    this.plane.visible = this.grid.visible = this.surface.isEmpty;
    this.legend.hidden = this.surface.isEmpty;
    if (this.surface.extent) this.fit(this.surface.extent);
    this.look();
  }

  /** Show the surface as it is to be seen now: levelled, in its colours, heights from 0. */
  look(): void {
    const { range } = this.surface;
    const digits = Math.min(4, Math.max(0, 2 - Math.floor(Math.log10(range[1] - range[0] || 1))));
    this.ends.replaceChildren(...[range[1], range[0]].map((height) => make("span", {}, `${fixed(height - this.surface.base, digits)} nm`)));
    this.ramp.style.background = gradient(this.surface.palette);
    this.section.draw();
    this.flat.invalidate();
    this.invalidate();
  }

  /** Draw again what is over the image, in three dimensions. */
  drawSheet(): void {
    this.sheet.mesh.visible = !this.surface.isEmpty;
    this.sheet.draw(this.extent, this.flat.overlay);
    this.invalidate();
  }

  clear(): void {
    this.surface.clear();
    this.sheet.mesh.visible = false;
    this.plane.visible = this.grid.visible = true;
    this.legend.hidden = true;
    this.greatestForce = 1e-9;
    this.section.clear();
    this.flat.invalidate();
    this.mark.visible = false;
    this.picked = "";
    this.invalidate();
  }

  /** Look from above the front, as at a table. */
  reset(): void {
    this.isTurned = false;
    const { x, y } = this.extent;
    const side = this.size;
    this.camera.near = side;
    this.camera.far = 4000 * side;
    this.camera.updateProjectionMatrix();
    this.orbit.maxDistance = 1500 * side;
    // a tall window shows the whole width from further away
    const away = side * Math.max(NEAREST, NEAREST_WIDE / this.camera.aspect);
    this.orbit.target.set(x - 6 * side, -6 * side, -y);
    this.camera.position.set(50, 85, 175).multiplyScalar(away).add(this.orbit.target);
    this.orbit.update();
  }

  /** How much larger than the plane without an image that is which is shown. */
  private get size(): number {
    return Math.max(this.extent.width, this.extent.depth) / PLANE_NM || 1;
  }

  /** Show another part of the sample: the tip in proportion, bars beside it, the camera as at the beginning. */
  private fit(extent: Extent): void {
    const { x, y, width, depth } = extent;
    const changed = Math.abs(width - this.extent.width) + Math.abs(depth - this.extent.depth) + Math.abs(x - this.extent.x) + Math.abs(y - this.extent.y);
    if (changed < 1e-3 * (width + depth)) return;
    this.extent = extent;
    const side = this.size;
    this.tip.scale.setScalar(side);
    for (const shape of [this.contact, this.mark]) shape.scale.setScalar(side);
    this.buildBars();
    this.reset();
  }

  private buildBars(): void {
    empty(this.bars);
    if (this.extent.width) this.bars.add(axesAndBars(this.extent, this.size, this.stretch, niceLength(0.2 * PLANE_NM * this.size)));
  }

  recolour(): void {
    this.invalidate();
    this.buildBars();
    this.scene.background = new Color(colour("scene"));
    this.plane.material.color.set(colour("line"));
    for (const [helper, token] of [[this.normal, "tip"], [this.lateral, "lateral"]] as const) helper.setColor(colour(token));
    this.world.remove(this.grid);
    this.grid = new GridHelper(PLANE_NM, 12, colour("quiet"), colour("quiet"));
    (this.grid.material as { opacity: number; transparent: boolean }).opacity = 0.35;
    (this.grid.material as { transparent: boolean }).transparent = true;
    this.grid.rotation.x = Math.PI / 2;
    this.grid.position.z = 0.05;
    this.grid.visible = this.surface.isEmpty;
    this.world.add(this.grid);
    this.section.recolour();
    this.flat.invalidate();
  }

  setStereo(stereo: Stereo): void {
    this.stereo = stereo;
    if (stereo === "anaglyph") this.anaglyph ??= new AnaglyphEffect(this.renderer);
    if (stereo === "side by side") this.sideBySide ??= new StereoEffect(this.renderer);
    this.resize();
    if (stereo === "off") this.renderer.setScissorTest(false);
  }

  /** Return the time that drawing took since this was last asked [ms]; that of the graphics processor is not in it. */
  takeCost(): number {
    const cost = this.cost;
    this.cost = 0;
    return cost;
  }

  private draw(): void {
    // It is not seen, and without a graphics processor it is drawn in software.
    if (this.solid.hidden && !this.headset.isPresenting) return;
    const now = performance.now();
    const isDue = this.pace.isDue(now);
    if (!(this.dirty && isDue) && !this.headset.isPresenting) return;
    this.dirty = false;
    this.pace.drawn(now);
    this.frames++;
    this.render();
    this.cost += performance.now() - now;
  }

  private render(): void {
    this.place();
    if (this.headset.isPresenting) this.headset.update(() => this.headsetLines());
    if (this.headset.isPresenting || this.stereo === "off") this.renderer.render(this.scene, this.camera);
    else {
      // what the eyes turn to has no parallax, and lies in the plane of the screen
      const distance = this.camera.position.distanceTo(this.orbit.target);
      if (this.anaglyph) [this.anaglyph.planeDistance, this.anaglyph.eyeSep] = [distance, distance * EYE_SHARE];
      this.camera.focus = distance;
      this.sideBySide?.setEyeSeparation(distance * EYE_SHARE);
      (this.stereo === "anaglyph" ? this.anaglyph : this.sideBySide)!.render(this.scene, this.camera);
    }
  }

  /** Where a height [nm] is in the scene: the lowest point of the image is its floor. */
  private level(height: number): number {
    return (height - (this.surface.isEmpty ? 0 : this.surface.base)) * this.stretch;
  }

  private place(): void {
    const of = (column: string): number => this.store.last("tip", column);
    const [x, y] = [or(of("x")) * NM, or(of("y")) * NM];
    const force = of("force");
    const [forceX, forceY] = [or(of("force_x")), or(of("force_y"))];
    const separation = of("separation");
    for (const relief of [this.surface.mesh, this.section.polyline]) {
      relief.position.z = this.level(0);
      relief.scale.z = this.stretch;
    }
    this.mark.position.z = this.level(this.markHeight);
    const height = this.level(this.surface.heightAt(x, y));
    const apex = height + (Number.isNaN(separation) ? or(of("base")) * -NM + 10 : separation * NM) * this.stretch;
    const side = this.size;
    this.tip.position.set(x, y, apex);
    this.tip.bend((or(of("deflection")) * NM * DEFLECTION_FACTOR) / side);
    const inContact = this.store.fact(AFM, "in_contact") === true;
    const meniscus = this.store.fact(AFM, "meniscus") === true;
    this.contact.visible = inContact || meniscus;
    this.contact.position.set(x, y, height + 0.15 * side);
    const ring = colour(inContact ? "tip" : "water");
    (this.contact.material as MeshStandardMaterial).color.set(ring);
    (this.contact.material as MeshStandardMaterial).emissive.set(ring);
    this.greatestForce = Math.max(this.greatestForce, Math.abs(or(force)), Math.hypot(forceX, forceY));
    point(this.normal, [x, y, apex], [0, 0, or(force)], ARROW_NM / this.greatestForce, side);
    point(this.lateral, [x, y, apex], [forceX, forceY, 0], ARROW_NM / this.greatestForce, side);
  }

  /** Write the numbers beside the picture: a few times a second, faster they cannot be read. */
  write(): void {
    const separation = this.store.last("tip", "separation");
    const side = this.size;
    const heights = this.stretch === 1 ? "to scale" : `and distances of the tip drawn ${this.stretch} times as high`;
    const { store } = this;
    this.views.toggleAttribute("data-old", store.isPictureOld || store.isOld("tip"));
    const apex = this.world.localToWorld(this.tip.position.clone()).project(this.camera);
    const isAway = Math.max(Math.abs(apex.x), Math.abs(apex.y)) > 1 && !Number.isNaN(separation);
    const text = [
      this.surface.isEmpty ? "No image yet: the plane of contact, grid 10 nm" : `Heights as measured, ${heights}`,
      `cantilever bent ${DEFLECTION_FACTOR} ×${side > 1.01 || side < 0.99 ? `, it and the tip drawn ${side.toPrecision(2)} ×` : ""}, longest arrow ${quantity(this.greatestForce, "N")}`,
      isAway ? `the tip is out of the picture, ${+Math.abs(1e9 * separation).toPrecision(3)} nm ${separation < 0 ? "into the sample" : "away"}` : "",
      this.picked,
    ].filter(Boolean).join(" · ");
    if (this.note.textContent !== text) this.note.textContent = this.note.title = text;
  }

  private buildOverlay(): void {
    const stereo = make(
      "select",
      { id: "stereo", "aria-label": "Stereo", onchange: () => this.setStereo(stereo.value as Stereo) },
      ...["off", "anaglyph", "side by side"].map((name) => make("option", { value: name }, name === "off" ? "Stereo off" : name)),
    );
    const zoom = (factor: number) => () => {
      this.isTurned = true;
      this.camera.position.sub(this.orbit.target).multiplyScalar(factor).add(this.orbit.target);
      this.orbit.update();
    };
    const group = (label: string, ...parts: HTMLElement[]): HTMLElement => make("div", { class: "segments", role: "group", "aria-label": label }, ...parts);
    const bar = make("div", { class: "bar" });
    bar.append(
      group("What the pointer does", ...Object.values(this.tools)),
      group("What is shown", ...this.showButtons),
      make("span", { class: "spacer" }),
      make(
        "details",
        { class: "menu", id: "scene-more" },
        make("summary", { "aria-label": "More of the scene: zoom, heights, stereo, headset" }, "⋯"),
        make(
          "div",
          { class: "sheet" },
          group(
            "View",
            make("button", { type: "button", "aria-label": "Zoom in", onclick: zoom(0.8) }, "+"),
            make("button", { type: "button", "aria-label": "Zoom out", onclick: zoom(1.25) }, "−"),
            make("button", { type: "button", id: "reset-view", onclick: () => this.reset() }, "Reset"),
          ),
          this.stretchSelect,
          stereo,
          this.headset.button,
        ),
      ),
    );
    this.solid.append(this.legend, this.tag);
    this.views.append(this.solid, this.flat.element, this.section.element);
    this.root.append(bar, this.views, this.note);
    this.show("solid");
  }

  private toolButton(tool: Tool, id: string, text: string, title: string): HTMLButtonElement {
    return make("button", { type: "button", id, title, hidden: tool === "press" || tool === "place", "aria-pressed": "false", onclick: () => this.setTool(this.tool === tool ? this.usual : tool) }, text);
  }

  /** Offer what this page may do with the tip: press it with the virtual hand, and move it. */
  offer(presses: boolean, places: boolean): void {
    const hadPress = !this.tools.press.hidden;
    this.tools.press.hidden = !presses;
    this.tools.place.hidden = !places;
    if (presses !== hadPress || this.tools[this.tool].hidden) this.setTool(this.usual);
  }

  private get usual(): Tool {
    return this.tools.press.hidden ? "turn" : "press";
  }

  private setTool(tool: Tool): void {
    this.tool = tool;
    this.root.dataset["tool"] = tool;
    for (const [name, button] of Object.entries(this.tools)) button.setAttribute("aria-pressed", String(name === tool));
    this.section.setOn(tool === "profile");
  }

  private show(shown: Shown, isChosen = false): void {
    this.isShownByChoice ||= isChosen;
    this.views.dataset["views"] = shown;
    for (const button of this.showButtons) button.setAttribute("aria-pressed", String(button.id === `show-${shown}`));
    this.solid.hidden = shown === "flat";
    this.flat.element.hidden = shown === "solid";
    this.flat.invalidate();
  }

  private say(text: string): void {
    this.picked = text;
    this.invalidate();
  }

  /** The place under the pointer on the surface, or on the plane of contact [nm]; none beside them. */
  private under(event: MouseEvent): Vector3 | undefined {
    const bounds = this.renderer.domElement.getBoundingClientRect();
    const at = new Vector2(((event.clientX - bounds.left) / bounds.width) * 2 - 1, 1 - ((event.clientY - bounds.top) / bounds.height) * 2);
    this.raycaster.setFromCamera(at, this.camera);
    const hit = this.raycaster.intersectObject(this.surface.isEmpty ? this.plane : this.surface.mesh)[0];
    return hit && this.world.worldToLocal(hit.point);
  }

  private pick(event: MouseEvent): void {
    const place = this.under(event);
    if (!place) return;
    const found = this.surface.nearest(place.x, place.y);
    const [x, y, z] = found?.at ?? [place.x, place.y, 0];
    this.mark.visible = true;
    this.markHeight = found?.shown ?? 0;
    this.mark.position.set(x, y, this.level(this.markHeight));
    const which = found ? `Measured point ${found.point} of line ${found.line}` : "Point of the plane";
    this.say(`${which}: x ${fixed(x, 3)} nm, y ${fixed(y, 3)} nm, z ${fixed(z, 3)} nm.`);
  }

  /** Move the tip, or draw the section, with the pointer instead of turning the scene. */
  private beginDrag(event: PointerEvent): void {
    // with the right button, and with two fingers, the scene is turned whatever the tool is
    this.orbit.mouseButtons.RIGHT = this.tool === "turn" ? MOUSE.PAN : MOUSE.ROTATE;
    if (this.tool === "turn" || event.button !== 0) return;
    if (this.tool === "press") {
      this.beginPress(event);
      return;
    }
    const placesTip = this.tool === "place";
    const from = this.under(event);
    if (!from) return;
    if (placesTip) this.onPlace(from.x, from.y);
    const canvas = this.renderer.domElement;
    this.orbit.enabled = false;
    canvas.setPointerCapture(event.pointerId);
    let newest = event;
    let isWaiting = false;
    const follow = (): void => {
      isWaiting = false;
      const to = this.under(newest);
      if (!to) return;
      if (placesTip) this.onPlace(to.x, to.y);
      else if (Math.hypot(to.x - from.x, to.y - from.y) > 0.01) this.section.set([from.x, from.y], [to.x, to.y]);
    };
    const move = (moved: PointerEvent): void => {
      newest = moved;
      // one ray a frame: an image has half a million triangles
      if (!isWaiting) requestAnimationFrame(follow);
      isWaiting = true;
    };
    const end = (): void => {
      this.orbit.enabled = true;
      canvas.removeEventListener("pointermove", move);
      for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) canvas.removeEventListener(name, end);
    };
    canvas.addEventListener("pointermove", move);
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) canvas.addEventListener(name, end);
  }

  /** Say beside the pointer what is pressed with now, also while the pointer rests. */
  writeTag(): void {
    if (!this.tag.hidden) this.tag.textContent = this.pressText();
  }

  /** Push the tip with the pointer: the further down, the harder. */
  private beginPress(event: PointerEvent): void {
    const canvas = this.renderer.domElement;
    if (!event.isPrimary) return;
    this.orbit.enabled = false;
    canvas.setPointerCapture(event.pointerId);
    const from = event.clientY;
    this.onPress(0);
    const follow = (moved: PointerEvent): void => {
      if (moved.pointerId !== event.pointerId) return;
      this.onPress((moved.clientY - from) / canvas.clientHeight);
      const bounds = this.solid.getBoundingClientRect();
      this.tag.hidden = false;
      this.tag.textContent = this.pressText();
      this.tag.style.left = `${Math.min(moved.clientX - bounds.left + 14, bounds.width - this.tag.offsetWidth - 4)}px`;
      this.tag.style.top = `${Math.min(moved.clientY - bounds.top - 10, bounds.height - 24)}px`;
    };
    const end = (): void => {
      this.orbit.enabled = true;
      this.tag.hidden = true;
      this.onPress(null);
      canvas.removeEventListener("pointermove", follow);
      for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) canvas.removeEventListener(name, end);
    };
    canvas.addEventListener("pointermove", follow);
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) canvas.addEventListener(name, end);
  }

  private headsetLines(): string[] {
    const of = (column: string, unit: string): string => quantity(this.store.last("tip", column), unit);
    return [
      [...part("banners").children].map((banner) => banner.textContent).join(", "),
      `Normal force ${of("force", "N")}`,
      `Tip to sample ${of("separation", "m")}`,
      "Trigger presses, grips hold, A B X Y: stop",
      this.nextText(),
    ];
  }

  private resize(): void {
    const { clientWidth: width, clientHeight: height } = this.solid;
    if (!width || !height || this.headset.isPresenting) return;
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.renderer.setSize(width, height);
    this.anaglyph?.setSize(width, height);
    this.sideBySide?.setSize(width, height);
    if (!this.isTurned) this.reset();
    this.invalidate();
  }
}

function or(value: number): number {
  return Number.isNaN(value) ? 0 : value;
}
