import {
  ArrowHelper,
  BoxGeometry,
  BufferGeometry,
  CanvasTexture,
  Float32BufferAttribute,
  Group,
  LineBasicMaterial,
  LineSegments,
  Mesh,
  MeshBasicMaterial,
  Sprite,
  SpriteMaterial,
  Vector3,
  type Material,
} from "three";
import { colour, make } from "./dom";
import { ticks } from "./ticks";

/** The part of the sample that is shown, in nm; `side` is how much larger it is than usual, `stretch` that of heights. */
export interface Extent {
  x: number;
  y: number;
  width: number;
  depth: number;
}

/** An arrow that the tip does not hide. */
export function arrow(rgb: string): ArrowHelper {
  const helper = new ArrowHelper(new Vector3(0, 0, 1), new Vector3(), 1, rgb, 5, 3);
  for (const part of [helper.line, helper.cone]) {
    (part.material as Material).depthTest = false;
    part.renderOrder = 3;
  }
  return helper;
}

/** Draw a force from a place; `scale` is in nm of a scene of usual size, `side` how much larger this one is. */
export function point(helper: ArrowHelper, from: [number, number, number], force: [number, number, number], scale: number, side: number): void {
  const vector = new Vector3(...force).multiplyScalar(scale);
  const length = vector.length();
  helper.visible = length > 0.5;
  if (!helper.visible) return;
  helper.position.set(...from);
  helper.setDirection(vector.normalize());
  helper.setLength(length * side, Math.min(6, length * 0.4) * side, 3.2 * side);
}

/** The greatest of 1, 2 or 5 times a power of ten that is not above a length. */
export function niceLength(most: number): number {
  const power = 10 ** Math.floor(Math.log10(most) + 1e-9);
  return [5, 2, 1].map((factor) => factor * power).find((length) => length <= most * (1 + 1e-9)) ?? power;
}

/** A length in nm as a text. */
export function lengthText(length: number): string {
  return length >= 1000 ? `${length / 1000} µm` : `${+length.toPrecision(2)} nm`;
}

/** Axes in nm before and right of what is shown, with ticks, and bars of a round length left of it, where nothing hides them. */
export function axesAndBars(extent: Extent, side: number, stretch: number, longest: number): Group {
  const { x, y, width, depth } = extent;
  const [left, right, front, back] = [x - width / 2, x + width / 2, y - depth / 2, y + depth / 2];
  const away = 4 * side;
  const group = new Group();
  const lines: number[] = [left, front - away, 0, right, front - away, 0, right + away, front, 0, right + away, back, 0];
  const write = (text: string, place: [number, number, number]): void => {
    const label = caption(text);
    label.scale.multiplyScalar(side);
    label.position.set(...place);
    group.add(label);
  };
  for (const [at, text] of ticks(left, right)) {
    lines.push(at, front - away, 0, at, front - away - 2 * side, 0);
    write(text, [at, front - away - 7 * side, 0]);
  }
  for (const [at, text] of ticks(front, back)) {
    lines.push(right + away, at, 0, right + away + 2 * side, at, 0);
    write(text, [right + away + 8 * side, at, 0]);
  }
  write("x, nm", [x, front - away - 16 * side, 0]);
  write("y, nm", [right + away + 22 * side, y, 0]);
  const geometry = new BufferGeometry().setAttribute("position", new Float32BufferAttribute(lines, 3));
  group.add(new LineSegments(geometry, new LineBasicMaterial({ color: colour("quiet") })));
  const high = niceLength(longest / 2 / stretch);
  const corner: [number, number, number] = [left - 34 * side, front, 0];
  rod(group, [longest, 0, 0], corner, side);
  rod(group, [0, longest, 0], corner, side);
  rod(group, [0, 0, high * stretch], corner, side);
  write(`x ${lengthText(longest)}`, [corner[0] + longest / 2, corner[1] - 8 * side, 0]);
  write(`y ${lengthText(longest)}`, [corner[0] + 15 * side, corner[1] + longest + 2 * side, 0]);
  write(`z ${lengthText(high)}`, [corner[0] - 9 * side, corner[1], high * stretch + 5 * side]);
  return group;
}

function rod(group: Group, along: [number, number, number], from: [number, number, number], side: number): void {
  const size = along.map((length) => Math.max(Math.abs(length), 0.9 * side)) as [number, number, number];
  const shape = new Mesh(new BoxGeometry(...size), new MeshBasicMaterial({ color: colour("quiet") }));
  shape.position.set(from[0] + along[0] / 2, from[1] + along[1] / 2, from[2] + along[2] / 2);
  group.add(shape);
}

/** A text that faces the viewer and that nothing hides. */
function caption(text: string): Sprite {
  const canvas = make("canvas", { width: 256, height: 64 });
  const pen = canvas.getContext("2d")!;
  pen.font = "600 44px system-ui, sans-serif";
  pen.textAlign = "center";
  pen.fillStyle = colour("text");
  pen.fillText(text, 128, 48);
  const sprite = new Sprite(new SpriteMaterial({ map: new CanvasTexture(canvas), transparent: true, depthTest: false }));
  sprite.scale.set(26, 6.5, 1);
  return sprite;
}

/** Let go of what the graphics processor keeps for the members of a group, and empty it. */
export function empty(group: Group): void {
  group.traverse((part) => {
    if (!(part instanceof Mesh || part instanceof LineSegments || part instanceof Sprite)) return;
    part.geometry.dispose();
    const material = part.material as SpriteMaterial;
    material.map?.dispose();
    material.dispose();
  });
  group.clear();
}
