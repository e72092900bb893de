import {
  CanvasTexture,
  Color,
  ConeGeometry,
  Group,
  Matrix4,
  Mesh,
  MeshBasicMaterial,
  MeshStandardMaterial,
  PlaneGeometry,
  Vector3,
  type Scene,
  type WebGLRenderer,
  type XRTargetRaySpace,
} from "three";
import { make } from "./dom";
import { aimed, carried } from "./grab";

/** A hundred nanometres are forty centimetres on a table in front of the viewer. */
const SCALE = 0.004;
const PLACE = new Vector3(0, 1.0, -0.6);
const BACKGROUND = 0x10171e;
const PANEL = { width: 512, height: 236, metres: 0.42 };
const PANEL_MS = 150;
/** Of the standard mapping of controllers: the two buttons beside the stick. */
const STOP_BUTTONS = [4, 5];
/** The stick itself, pressed. */
const NEXT_BUTTONS = [3];

/** The world in a headset: on a table, held with the grips, the tip pressed with a trigger, and a panel of numbers. */
export class Headset {
  readonly button: HTMLButtonElement;
  /** Called while a trigger is held: how far the controller has moved down since then [m]; null when let go. */
  onPress: (down: number | null, across?: [number, number]) => void = () => {};
  /** Returns what moves with the left controller, whose trigger was pulled while it points there [nm]; nothing where that presses. */
  onGrab: (x: number, y: number) => ((x: number, y: number) => void) | undefined = () => undefined;
  /** Called when a button beside the stick is pressed. */
  onStop: () => void = () => {};
  /** Called when a stick is pressed. */
  onNext: () => void = () => {};
  onLeave: () => void = () => {};
  /** How much larger than usual that is which lies on the table. */
  size: () => number = () => 1;
  private readonly controllers: XRTargetRaySpace[];
  private readonly held = new Set<XRTargetRaySpace>();
  private before: Matrix4[] = [];
  private pressed: { controller: XRTargetRaySpace; from: Vector3 } | undefined;
  private dragged: { controller: XRTargetRaySpace; to: (x: number, y: number) => void } | undefined;
  private isStopping = false;
  private isGoing = false;
  private readonly canvas = make("canvas", { width: PANEL.width, height: PANEL.height });
  private readonly panel: Mesh<PlaneGeometry, MeshBasicMaterial>;
  private writtenAt = 0;

  constructor(
    private readonly renderer: WebGLRenderer,
    private readonly scene: Scene,
    private readonly world: Group,
    say: (text: string) => void,
  ) {
    const toggle = (): void => void this.toggle().catch((error) => say(`No session of the headset: ${String(error)}.`));
    this.button = make("button", { type: "button", id: "vr", hidden: true, onclick: toggle }, "Enter VR");
    const material = new MeshBasicMaterial({ map: new CanvasTexture(this.canvas), transparent: true });
    this.panel = new Mesh(new PlaneGeometry(PANEL.metres, (PANEL.metres * PANEL.height) / PANEL.width), material);
    this.panel.position.set(0, 1.42, -0.85);
    this.panel.visible = false;
    scene.add(this.panel);
    const xr = navigator.xr;
    renderer.xr.enabled = xr !== undefined;
    this.controllers = xr ? [0, 1].map((i) => this.follow(i)) : [];
    void xr?.isSessionSupported("immersive-vr").then((supported) => (this.button.hidden = !supported));
  }

  get isPresenting(): boolean {
    return this.renderer.xr.isPresenting;
  }

  /** Move what is held, report the trigger, and write the numbers; called before each picture of a session. */
  update(lines: () => string[]): void {
    const held = this.controllers.filter((controller) => this.held.has(controller));
    const now = held.map((controller) => controller.matrix.clone());
    if (now.length && now.length === this.before.length) this.set(carried(this.world.matrix, this.before, now));
    this.before = now;
    if (this.pressed) {
      // The scene has y up; right and away from the viewer are x and y over the sample.
      const { from, controller } = this.pressed;
      const at = where(controller);
      this.onPress(from.y - at.y, [at.x - from.x, from.z - at.z]);
    }
    if (this.dragged) {
      const to = aimed(this.world.matrix, this.dragged.controller.matrix);
      if (to) this.dragged.to(...to);
    }
    this.readButtons();
    const at = performance.now();
    if (at - this.writtenAt < PANEL_MS) return;
    this.writtenAt = at;
    this.write(lines());
  }

  private follow(index: number): XRTargetRaySpace {
    const controller = this.renderer.xr.getController(index);
    const pointer = new Mesh(new ConeGeometry(0.008, 0.05, 16), new MeshStandardMaterial({ color: 0xffb000, emissive: 0x805800 }));
    pointer.rotation.x = -Math.PI / 2;
    controller.add(pointer);
    this.scene.add(controller);
    const hold = (holds: boolean) => (): void => {
      if (holds) this.held.add(controller);
      else this.held.delete(controller);
      // another number of hands holds it another way: nothing moves before the next picture
      this.before = [];
    };
    controller.addEventListener("squeezestart", hold(true));
    controller.addEventListener("squeezeend", hold(false));
    let isLeft = false;
    controller.addEventListener("connected", ({ data }) => (isLeft = data.handedness === "left"));
    controller.addEventListener("selectstart", () => {
      const at = isLeft ? aimed(this.world.matrix, controller.matrix) : undefined;
      const to = at && this.onGrab(...at);
      if (to) this.dragged = { controller, to };
      else this.pressed ??= { controller, from: where(controller) };
    });
    const letGo = (): void => {
      if (this.dragged?.controller === controller) this.dragged = undefined;
      if (this.pressed?.controller !== controller) return;
      this.pressed = undefined;
      this.onPress(null);
    };
    controller.addEventListener("selectend", letGo);
    // one that is lost, or whose battery is empty, holds nothing
    controller.addEventListener("disconnected", () => {
      hold(false)();
      letGo();
    });
    return controller;
  }

  private readButtons(): void {
    const sources = [...(this.renderer.xr.getSession()?.inputSources ?? [])];
    const isDown = (buttons: number[]): boolean => sources.some((source) => buttons.some((i) => source.gamepad?.buttons[i]?.pressed));
    const [stops, goes] = [isDown(STOP_BUTTONS), isDown(NEXT_BUTTONS)];
    if (stops && !this.isStopping) this.onStop();
    if (goes && !this.isGoing) this.onNext();
    [this.isStopping, this.isGoing] = [stops, goes];
  }

  private write(lines: string[]): void {
    const pen = this.canvas.getContext("2d")!;
    pen.fillStyle = "#171e25";
    pen.fillRect(0, 0, PANEL.width, PANEL.height);
    pen.font = "600 30px system-ui, sans-serif";
    lines.forEach((line, i) => {
      pen.fillStyle = i ? "#e4eaf0" : "#f0b352";
      pen.fillText(line, 16, 42 + 44 * i);
    });
    this.panel.material.map!.needsUpdate = true;
  }

  private set(matrix: Matrix4): void {
    matrix.decompose(this.world.position, this.world.quaternion, this.world.scale);
    this.world.updateMatrix();
  }

  private async toggle(): Promise<void> {
    const running = this.renderer.xr.getSession();
    if (running) {
      await running.end();
      return;
    }
    const session = await navigator.xr!.requestSession("immersive-vr", { requiredFeatures: ["local-floor"] });
    const background = this.scene.background;
    this.scene.background = new Color(BACKGROUND);
    this.world.scale.setScalar(SCALE / this.size());
    this.world.position.copy(PLACE);
    this.world.updateMatrix();
    this.panel.visible = true;
    this.button.textContent = "Leave VR";
    session.addEventListener("end", () => {
      this.world.scale.setScalar(1);
      this.world.position.set(0, 0, 0);
      this.world.rotation.set(-Math.PI / 2, 0, 0);
      this.scene.background = background;
      this.panel.visible = false;
      this.held.clear();
      this.before = [];
      if (this.pressed) this.onPress(null);
      this.pressed = this.dragged = undefined;
      this.button.textContent = "Enter VR";
      this.onLeave();
    });
    await this.renderer.xr.setSession(session);
  }
}

function where(controller: XRTargetRaySpace): Vector3 {
  return new Vector3().setFromMatrixPosition(controller.matrix);
}
