import { CanvasTexture, Mesh, MeshBasicMaterial, PlaneGeometry } from "three";
import { make } from "./dom";
import type { Flat } from "./flat";
import type { Extent } from "./shapes";

const PIXELS = 512;

/** What is drawn over the image from above, on a sheet in the plane of the sample: in three dimensions and in a headset. */
export class Sheet {
  private readonly canvas = make("canvas", { width: PIXELS, height: PIXELS });
  // seen through what stands on the sample
  readonly mesh = new Mesh(new PlaneGeometry(1, 1), new MeshBasicMaterial({ map: new CanvasTexture(this.canvas), transparent: true, depthTest: false }));

  draw({ x, y, width, depth }: Extent, overlay: Flat["overlay"]): void {
    const side = Math.max(width, depth);
    const scale = PIXELS / side;
    const pen = this.canvas.getContext("2d")!;
    pen.clearRect(0, 0, PIXELS, PIXELS);
    overlay(pen, (atX, atY) => [PIXELS / 2 + (atX - x) * scale, PIXELS / 2 - (atY - y) * scale], scale);
    this.mesh.position.set(x, y, 0);
    this.mesh.scale.set(side, side, 1);
    this.mesh.material.map!.needsUpdate = true;
  }
}
