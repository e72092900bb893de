import { BoxGeometry, ConeGeometry, Group, Mesh, MeshStandardMaterial, SphereGeometry, type BufferAttribute } from "three";

const CANTILEVER_NM = 130;
const TIP_NM = 34;
const TIP_RADIUS_NM = 2.5;
const BEAM = { width: 26, thickness: 3, overhang: 8, parts: 24 };

/** Tip and cantilever: the apex is at the origin, the clamp on the side of -x [nm]. */
export class Probe extends Group {
  private readonly beam: Mesh<BoxGeometry, MeshStandardMaterial>;
  private readonly straight: Float32Array;
  private bent = 0;

  constructor() {
    super();
    const silicon = new MeshStandardMaterial({ color: 0x8fa3b8, metalness: 0.35, roughness: 0.45 });
    const cone = new Mesh(new ConeGeometry(10, TIP_NM - TIP_RADIUS_NM, 32), silicon);
    cone.rotation.x = -Math.PI / 2;
    cone.position.z = (TIP_NM + TIP_RADIUS_NM) / 2;
    const apex = new Mesh(new SphereGeometry(TIP_RADIUS_NM, 24, 16), silicon);
    apex.position.z = TIP_RADIUS_NM;
    const shape = new BoxGeometry(CANTILEVER_NM, BEAM.width, BEAM.thickness, BEAM.parts, 1, 1);
    shape.translate(BEAM.overhang - CANTILEVER_NM / 2, 0, TIP_NM + 2);
    const faceted = new MeshStandardMaterial({ color: 0x8fa3b8, metalness: 0.35, roughness: 0.45, flatShading: true });
    this.beam = new Mesh(shape, faceted);
    this.beam.frustumCulled = false;
    this.straight = Float32Array.from(shape.getAttribute("position").array);
    this.add(cone, apex, this.beam);
  }

  /** Bend the beam like one clamped at its end and loaded at the tip: z = d (3 s^2 - s^3) / 2. */
  bend(deflection: number): void {
    if (Math.abs(deflection - this.bent) < 1e-3) return;
    this.bent = deflection;
    const position = this.beam.geometry.getAttribute("position") as BufferAttribute;
    for (let i = 0; i < position.count; i++) {
      // the apex is where the tip is: the clamp moves against it
      const s = (this.straight[3 * i]! + CANTILEVER_NM - BEAM.overhang) / CANTILEVER_NM;
      position.setZ(i, this.straight[3 * i + 2]! + deflection * ((3 * s * s - s ** 3) / 2 - 1));
    }
    position.needsUpdate = true;
  }
}
