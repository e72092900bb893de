import { ArrowHelper, BoxGeometry, CanvasTexture, Group, Mesh, MeshStandardMaterial, Sprite, SpriteMaterial, Vector3, type Material } from "three";
import { make } from "./dom";

/** An arrow that the tip does not hide. */
export function arrow(rgb: number): ArrowHelper {
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
  const power = 10 ** Math.floor(Math.log10(most));
  return [5, 2, 1].map((factor) => factor * power).find((length) => length <= most) ?? power;
}

/** A bar that begins at a corner and goes along an axis; its label has the axis and the length. */
export function bar(axis: "x" | "y" | "z", length: number, at: [number, number, number], side: number): Group {
  const along = "xyz".indexOf(axis);
  const size: [number, number, number] = [0.9 * side, 0.9 * side, 0.9 * side];
  size[along] = length;
  const middle: [number, number, number] = [0, 0, 0];
  middle[along] = length / 2;
  const rod = new Mesh(new BoxGeometry(...size), new MeshStandardMaterial({ color: 0x64748b }));
  rod.position.set(...middle);
  const label = caption(`${axis} ${length >= 1000 ? `${length / 1000} µm` : `${+length.toPrecision(2)} nm`}`);
  label.scale.multiplyScalar(side);
  label.position.set(...middle);
  if (axis === "x") label.position.y -= 6 * side;
  if (axis === "y") label.position.set(-6 * side, length + 4 * side, 0);
  if (axis === "z") label.position.z = length + 5 * side;
  const group = new Group();
  group.add(rod, label);
  group.position.set(...at);
  return group;
}

function caption(text: string): Sprite {
  const canvas = make("canvas", { width: 256, height: 64 });
  const pen = canvas.getContext("2d")!;
  pen.font = "600 44px system-ui, sans-serif";
  pen.textAlign = "center";
  pen.fillStyle = "#475569";
  pen.fillText(text, 128, 48);
  const sprite = new Sprite(new SpriteMaterial({ map: new CanvasTexture(canvas), transparent: true }));
  sprite.scale.set(26, 6.5, 1);
  return sprite;
}
