/** The camera of one robot's picture: it is fitted to what is there until a person moves it. */
import {PerspectiveCamera} from "three";
import {OrbitControls} from "three/addons/controls/OrbitControls.js";
import {NO_INSET, fit} from "./fit.js";

/** Directions from which the cell is looked at: towards the camera. */
const VIEWS = {home: [0.72, -0.62, 0.4], front: [1, 0, 0.14], side: [0, -1, 0.14], top: [0.001, 0, 1]};
/** Height of the picture as the camera sees it [deg]. */
const FOV = 38;

/**
 * Make the camera of a robot.
 *
 * @param {Element} overlay takes the gestures
 * @param {{position: {z: number}}} ground what is looked at is not below it
 */
export function makeCamera(overlay, ground, redraw) {
  const perspective = new PerspectiveCamera(FOV, 1, 0.05, 120);
  perspective.up.set(0, 0, 1);
  const controls = new OrbitControls(perspective, overlay);
  controls.maxDistance = 60;
  controls.minDistance = 0.3;
  // the floor is solid: from below nothing is seen
  controls.maxPolarAngle = Math.PI * 0.495;
  let inset = NO_INSET;
  let chosen = "home";
  controls.addEventListener("change", () => {
    controls.target.z = Math.max(controls.target.z, ground.position.z);
    redraw();
  });
  controls.addEventListener("start", () => {
    chosen = "";
  });

  function see(points, direction) {
    const {position, target} = fit(points, direction, FOV, perspective.aspect, inset);
    controls.target.fromArray(target);
    perspective.position.fromArray(position);
    controls.update();
    redraw();
  }

  /** Return where a point (Vector3) is in the picture: fractions from its upper left corner, and its depth, -1 to 1. */
  function onScreen(point) {
    const {x, y, z} = point.clone().project(perspective);
    return {x: (x + 1) / 2, y: (1 - y) / 2, z};
  }

  return {
    perspective, onScreen,
    /** The view that was chosen; "" once a person has turned or moved it by hand. */
    get chosen() {
      return chosen;
    },
    /** Look at points from the direction of a view. */
    look(view, points) {
      chosen = view;
      see(points, VIEWS[view] ?? VIEWS.home);
    },
    /** Look at points from where the camera is now. */
    lookAt(points) {
      chosen = "";
      see(points, perspective.position.clone().sub(controls.target).toArray());
    },
    /** Whether a point is in the part of the picture that is not covered. */
    isInView(point) {
      perspective.updateMatrixWorld();
      const {x, y, z} = onScreen(point);
      const {left, right, top, bottom} = inset;
      return z < 1 && x > left && x < 1 - right && y > top && y < 1 - bottom;
    },
    /** Have another part of the picture, so many pixels large, of which `covered` (fit.js) is covered. */
    resize(width, tall, covered = NO_INSET) {
      inset = covered;
      perspective.aspect = width / tall;
      perspective.updateProjectionMatrix();
    },
    /** For tests. */
    inspect: () => ({position: perspective.position.toArray(), target: controls.target.toArray(), chosen}),
  };
}
