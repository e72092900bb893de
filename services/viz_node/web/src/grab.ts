import { Matrix4, Quaternion, Vector3 } from "three";

/** What a nanometre may be in front of the viewer [m]: images are 10 nm to 100 µm wide. */
export const LEAST_SCALE = 1e-6;
export const MOST_SCALE = 0.1;

/**
 * Return the matrix of a world that is held by the controllers, after these have moved.
 *
 * One controller carries it like a thing in the hand. Two carry, turn and scale it: the points between which it is
 * held stay those between which it is held. The scale stays within its limits.
 */
export function carried(world: Matrix4, before: readonly Matrix4[], now: readonly Matrix4[]): Matrix4 {
  if (before.length !== now.length || !now.length) return world.clone();
  if (now.length === 1) return now[0]!.clone().multiply(before[0]!.clone().invert()).multiply(world);
  const [a, b] = [before[0]!, before[1]!].map(place) as [Vector3, Vector3];
  const [c, d] = [now[0]!, now[1]!].map(place) as [Vector3, Vector3];
  const [from, to] = [b.clone().sub(a), d.clone().sub(c)];
  if (from.length() < 1e-3 || to.length() < 1e-3) return world.clone();
  const scale = world.getMaxScaleOnAxis();
  const factor = Math.min(MOST_SCALE / scale, Math.max(LEAST_SCALE / scale, to.length() / from.length()));
  const turn = new Quaternion().setFromUnitVectors(from.normalize(), to.normalize());
  const [middle, then] = [a.add(b).multiplyScalar(0.5), c.add(d).multiplyScalar(0.5)];
  return new Matrix4()
    .compose(then, turn, new Vector3(factor, factor, factor))
    .multiply(new Matrix4().makeTranslation(middle.negate()))
    .multiply(world);
}

/** Where the ray of a controller meets the plane z = 0 of a world from above, in units of that world; none where it does not. */
export function aimed(world: Matrix4, controller: Matrix4): [number, number] | undefined {
  const inverse = world.clone().invert();
  const from = place(controller).applyMatrix4(inverse);
  const way = new Vector3(0, 0, -1).applyMatrix4(controller).applyMatrix4(inverse).sub(from);
  if (!(from.z > 0 && way.z < -1e-3 * way.length())) return undefined;
  const at = from.addScaledVector(way, -from.z / way.z);
  return [at.x, at.y];
}

function place(matrix: Matrix4): Vector3 {
  return new Vector3().setFromMatrixPosition(matrix);
}
