import { Matrix4, Quaternion, Vector3 } from "three";
import { describe, expect, test } from "vitest";
import { LEAST_SCALE, MOST_SCALE, aimed, carried } from "../src/grab";

const at = (x: number, y: number, z: number, turn = new Quaternion()): Matrix4 => new Matrix4().compose(new Vector3(x, y, z), turn, new Vector3(1, 1, 1));
const world = new Matrix4().compose(new Vector3(0.1, 1, -0.6), new Quaternion(), new Vector3(0.004, 0.004, 0.004));

function held(matrix: Matrix4, controller: Matrix4): Vector3 {
  return new Vector3().setFromMatrixPosition(controller).applyMatrix4(matrix.clone().invert());
}

describe("the world in the hands", () => {
  test("one controller carries and turns it", () => {
    const turn = new Quaternion().setFromAxisAngle(new Vector3(0, 1, 0), 0.7);
    const [before, now] = [at(0.2, 1.1, -0.5), at(0.3, 1.3, -0.4, turn)];
    const moved = carried(world, [before], [now]);
    expect(held(moved, now).distanceTo(held(world, before))).toBeLessThan(1e-9);
    expect(moved.getMaxScaleOnAxis()).toBeCloseTo(0.004, 12);
    expect(new Quaternion().setFromRotationMatrix(moved.clone().scale(new Vector3(250, 250, 250))).angleTo(turn)).toBeLessThan(1e-6);
  });

  test("two controllers keep hold of the same points while they move apart and turn", () => {
    const before = [at(-0.1, 1, -0.6), at(0.1, 1, -0.6)];
    const now = [at(0, 1.1, -0.4), at(0, 1.1, -0.8)];
    const moved = carried(world, before, now);
    expect(moved.getMaxScaleOnAxis()).toBeCloseTo(0.008, 9);
    for (const i of [0, 1]) expect(held(moved, now[i]!).distanceTo(held(world, before[i]!))).toBeLessThan(1e-6);
  });

  test("the scale has limits, and hands in one place change nothing", () => {
    const near = [at(-0.05, 1, 0), at(0.05, 1, 0)];
    const far = [at(-5000, 1, 0), at(5000, 1, 0)];
    expect(carried(world, near, far).getMaxScaleOnAxis()).toBeCloseTo(MOST_SCALE, 9);
    expect(carried(world, far, near).getMaxScaleOnAxis()).toBeCloseTo(LEAST_SCALE, 9);
    expect(carried(world, near, [at(0, 1, 0), at(0, 1, 0)]).equals(world)).toBe(true);
    expect(carried(world, [], near).equals(world)).toBe(true);
  });
});

test("a controller points at a place of the sample", () => {
  const down = new Quaternion().setFromAxisAngle(new Vector3(1, 0, 0), -Math.PI / 4);
  // the table lies at a height of 1 m, and its y goes away from the viewer
  const table = new Matrix4().compose(new Vector3(0, 1, -0.6), new Quaternion().setFromAxisAngle(new Vector3(1, 0, 0), -Math.PI / 2), new Vector3(0.004, 0.004, 0.004));
  // from 0.4 m above its middle and 0.4 m before it, and 80 mm to the right
  const [x, y] = aimed(table, at(0.08, 1.4, -0.2, down))!;
  expect(x).toBeCloseTo(20, 6);
  expect(y).toBeCloseTo(0, 6);
  expect(aimed(table, at(0, 1.4, -0.2))).toBeUndefined();
  expect(aimed(table, at(0, 0.5, -0.2, down))).toBeUndefined();
});
