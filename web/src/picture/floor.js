/** The floor: solid, with a line at each metre, and the light, whose shadows are on it. Metres, in base_link. */
import {
  DirectionalLight, GridHelper, Group, HemisphereLight, Mesh, MeshBasicMaterial, PlaneGeometry, ShadowMaterial, Vector3,
} from "three";

/** It reaches at least so far on all sides of the base, and at most so far [m]. */
const LEAST = 3;
const MOST = 30;
/** The lines are so far above the floor: nearer they would flicker [m]. */
const ABOVE = 2e-3;

/** Flat boxes at least so wide and deep are a floor [m]. */
const WIDE = 2;
/** A floor's top is at most so far above the base's foot [m]. */
const HIGHEST = 0.01;

/**
 * Return the object of a scene that is the floor, and how high its top is: a box that lies flat, below the base, wide
 * enough to stand on. Null where there is none.
 *
 * @returns {{name: string, height: number} | null} the highest of several
 */
export function floorOf(objects) {
  let found = null;
  for (const {name, shape, size, position, orientation, link} of objects) {
    if (link || shape !== "box" || size.length !== 3 || Math.min(size[0], size[1]) < WIDE) continue;
    if (Math.hypot(orientation[0], orientation[1]) > 1e-3) continue;
    const height = position[2] + size[2] / 2;
    if (height <= HIGHEST && (found === null || height > found.height)) found = {name, height};
  }
  return found;
}

/** Make the floor, a group with `theme`, `cover` and `shadows`; `userData.half` is how far it reaches. */
export function makeFloor() {
  const group = new Group();
  const plate = new Mesh(new PlaneGeometry(2, 2), new MeshBasicMaterial({polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1}));
  const shade = new Mesh(plate.geometry, new ShadowMaterial({opacity: 0.28, depthWrite: false}));
  shade.receiveShadow = true;
  let lines = null;
  let ink = "#888888";

  function draw() {
    const {half} = group.userData;
    lines?.dispose();
    lines?.removeFromParent();
    lines = new GridHelper(2 * half, 2 * half, ink, ink).rotateX(Math.PI / 2);
    lines.position.z = ABOVE;
    for (const each of [plate, shade]) each.scale.setScalar(half);
    group.add(plate, shade, lines);
  }

  group.userData.half = LEAST;
  draw();
  return Object.assign(group, {
    /** Take the theme's colours, as the style sheet writes them. */
    theme(plain, line) {
      plate.material.color.set(plain);
      ink = line;
      draw();
    },
    /** Be as large as what stands on it, at a height. */
    cover(points, height) {
      group.position.z = height;
      const far = Math.max(LEAST, ...points.flatMap(([x, y]) => [Math.abs(x), Math.abs(y)]));
      const half = Math.min(MOST, Math.ceil(far - 1e-6));
      if (half === group.userData.half) return;
      group.userData.half = half;
      draw();
    },
    shadows(on) {
      shade.visible = on;
    },
  });
}

/** Make the light of a scene: from the sky, from beside, and a sun that throws shadows. */
export function makeLight(scene) {
  const sun = new DirectionalLight(0xffffff, 2.1);
  const fill = new DirectionalLight(0xdfe9ff, 0.5);
  fill.position.set(-4, 3, 2.5);
  sun.shadow.mapSize.set(1024, 1024);
  sun.shadow.bias = -4e-4;
  sun.shadow.normalBias = 0.02;
  scene.add(new HemisphereLight(0xffffff, 0x8a8f99, 1.5), fill, sun, sun.target);
  return {
    /** Let the sun shine on all that is in a box. */
    cover(box) {
      const centre = box.getCenter(new Vector3());
      const radius = box.getSize(new Vector3()).length() / 2;
      sun.target.position.copy(centre);
      sun.position.set(0.45, -0.5, 1).normalize().multiplyScalar(2 * radius).add(centre);
      Object.assign(sun.shadow.camera, {left: -radius, right: radius, top: radius, bottom: -radius, near: 0.1, far: 4 * radius});
      sun.shadow.camera.updateProjectionMatrix();
    },
    shadows(on) {
      sun.castShadow = on;
    },
  };
}
