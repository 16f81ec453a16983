/** Objects of the scene, the building model, lines and markers. Metres, in base_link. */
import {
  BoxGeometry, BufferGeometry, Color, CylinderGeometry, DoubleSide, EdgesGeometry, Float32BufferAttribute, Group, LineBasicMaterial, LineSegments,
  Mesh, MeshBasicMaterial, MeshLambertMaterial, Points, PointsMaterial, SphereGeometry, Vector3,
} from "three";
import {Line2} from "three/addons/lines/Line2.js";
import {LineGeometry} from "three/addons/lines/LineGeometry.js";
import {LineMaterial} from "three/addons/lines/LineMaterial.js";
import {mergeGeometries} from "three/addons/utils/BufferGeometryUtils.js";
import * as colours from "./colours.js";
import {corners} from "./fit.js";
import {fetchOwn, loadMesh, readGlb} from "./robot_model.js";
import {stateOfElement} from "../work/task_list.js";

/** Free what a group holds on the graphics card. */
export function dispose(object) {
  object.traverse((child) => {
    child.geometry?.dispose();
    for (const material of [child.material ?? []].flat()) material.dispose();
  });
  object.removeFromParent();
}

/** Return the corners of what a body draws now, its frame's axes left out. */
export function cornersOf(object) {
  const found = [];
  object.updateWorldMatrix(true, true);
  object.traverse((child) => {
    if (!child.isMesh || child.name === "axes") return;
    child.geometry.boundingBox ?? child.geometry.computeBoundingBox();
    const {min, max} = child.geometry.boundingBox;
    found.push(...corners(min.toArray(), max.toArray()).map((corner) => new Vector3(...corner).applyMatrix4(child.matrixWorld).toArray()));
  });
  return found;
}

/**
 * Return a translucent material for a ghost.
 *
 * @param {boolean} front it is seen where it has the same surface as the twin, else the twin is
 */
export function ghostMaterial(colour, opacity, front) {
  const offset = front ? -1 : 1;
  return new MeshLambertMaterial({
    color: colour, opacity, transparent: true, polygonOffset: true, polygonOffsetFactor: offset, polygonOffsetUnits: offset,
  });
}

function geometryOf({shape, size}) {
  if (shape === "box") return new BoxGeometry(...size);
  if (shape === "sphere") return new SphereGeometry(size[0], 24, 16);
  if (shape === "cylinder") return new CylinderGeometry(size[0], size[0], size[1], 32).rotateX(Math.PI / 2);
  return null;
}

/** Larger boxes may hide the arm: it is seen through them [m]. */
const LARGE = 2;
/** Edges between faces that meet at more than this are drawn [deg]. */
const SHARP = 30;

const isVector = (value, length) => Array.isArray(value) && value.length === length && value.every(Number.isFinite);

/**
 * Return the body of an object of the scene, in its own frame at its pose; its mesh comes when it has been loaded.
 *
 * @param {object} object of the scene's message
 * @param {() => void} onChange called when a mesh has come
 */
export function sceneBody(object, onChange) {
  const carried = Boolean(object.link);
  const small = carried || isVector(object.size, 3) && object.shape === "box" && Math.hypot(...object.size) < LARGE || object.shape === "sphere";
  const material = new MeshLambertMaterial({
    color: carried ? colours.CARRIED : colours.STANDING, transparent: !small, opacity: small ? 1 : 0.5, side: DoubleSide, depthWrite: small,
  });
  const group = new Group();
  group.name = object.name;
  if (isVector(object.position, 3)) group.position.fromArray(object.position);
  if (isVector(object.orientation, 4)) group.quaternion.fromArray(object.orientation);
  group.userData.object = object.name;
  const geometry = isVector(object.size, object.size?.length ?? -1) ? geometryOf(object) : null;
  const take = (mesh) => {
    mesh.castShadow = mesh.receiveShadow = true;
    mesh.add(new LineSegments(new EdgesGeometry(mesh.geometry, SHARP), new LineBasicMaterial({color: colours.EDGE, transparent: true, opacity: 0.45})));
    group.add(mesh);
  };
  if (geometry !== null) {
    take(new Mesh(geometry, material));
  } else if (object.shape === "mesh" && /^[0-9a-f]{64}$/.test(object.mesh)) {
    loadMesh(`private/mesh/${object.mesh}.stl`, material).then((mesh) => {
      if (isVector(object.size, 3)) mesh.scale.fromArray(object.size);
      take(mesh);
      onChange();
    }, (error) => onChange(error));
  }
  return group;
}

/**
 * Return the building model in base_link; glTF has Y up. Its elements are found by `userData.element`; `hash` is of the
 * model that it was made from, "" for a file that does not say.
 */
export async function loadBuilding(url) {
  const bytes = await fetchOwn(url, (answer) => answer.arrayBuffer());
  const {scene, asset} = await readGlb(bytes);
  const group = new Group();
  group.rotation.x = Math.PI / 2;
  group.add(scene);
  const elements = new Map();
  scene.traverse((child) => {
    const element = child.userData.element ?? "";
    if (element === "") return;
    const material = new MeshLambertMaterial({transparent: true, side: DoubleSide});
    elements.set(element, {material, label: child.userData.label ?? child.name, node: child});
    child.traverse((mesh) => {
      if (!mesh.isMesh) return;
      mesh.material = material;
      mesh.castShadow = mesh.receiveShadow = true;
      mesh.userData.tapped = element;
    });
  });
  return {group, elements, hash: asset.extras?.model_hash ?? ""};
}

/** Colour the elements of a building by the states of their tasks. */
export function colourBuilding(building, tasks, picked) {
  for (const [element, {material}] of building.elements) {
    const state = tasks ? stateOfElement(tasks, element) : undefined;
    const [colour, opacity] = element === picked ? colours.PICKED : colours.BY_TASK[state] ?? colours.NO_TASK;
    material.color.set(colour);
    material.opacity = opacity;
    material.transparent = opacity < 1;
    material.depthWrite = opacity > 0.7;
    material.needsUpdate = true;
  }
}

/** Return points as dots of these colours, so many pixels wide. */
function dots(points, colours, size) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new Float32BufferAttribute(points.flat(), 3));
  geometry.setAttribute("color", new Float32BufferAttribute(colours.flatMap((colour) => new Color(colour).toArray()), 3));
  return new Points(geometry, new PointsMaterial({size, sizeAttenuation: false, vertexColors: true}));
}

/** So large are the dots at the waypoints, and at the ends of a path and of its segments [px]. */
const DOT = 2;
const END = 12;

/**
 * Return the planned path of the tool as a line with a dot at each waypoint, larger ones at its ends and at those of its segments.
 *
 * @param {number[][]} points [m]
 * @param {{tool_path_end: number, engaged: boolean}[]} segments of a work plan: where the tool is engaged has another colour
 * @param {number} ratio pixels of the screen by pixel of the page
 */
export function pathLine(points, segments = [], ratio = 1) {
  const group = new Group();
  const usable = points.filter((point) => isVector(point, 3));
  if (usable.length < 2) return group;
  const own = usable.map((point, k) => (isEngaged(segments, k) ? colours.PATH_ENGAGED : colours.PATH));
  const geometry = new LineGeometry();
  geometry.setPositions(usable.flat());
  geometry.setColors(own.flatMap((colour) => new Color(colour).toArray()));
  group.add(new Line2(geometry, new LineMaterial({linewidth: 4, vertexColors: true})));
  const ends = [...new Set([0, ...segments.map((each) => each.tool_path_end), usable.length - 1])].filter((k) => k >= 0 && k < usable.length);
  group.add(dots(usable, usable.map(() => colours.WAYPOINT), DOT * ratio), dots(ends.map((k) => usable[k]), ends.map((k) => own[k]), END * ratio));
  group.userData.waypoints = usable.length;
  return group;
}

/** Widths of a path that is played, ahead of the tool and behind it [px]. */
const AHEAD = 4;
const TRAVELLED = 2;

/** Return the path of a plan that is played; `show(played)` (played.js) sets it, null hides it. */
export function playedPath() {
  const group = new Group();
  const lines = [["travelled", colours.TRAVELLED, TRAVELLED], ["ahead", colours.AHEAD, AHEAD]].map(([part, colour, width]) => {
    const line = new Line2(new LineGeometry(), new LineMaterial({color: colour, linewidth: width}));
    group.add(line);
    return [part, line];
  });
  group.show = (played) => {
    group.visible = played !== null;
    for (const [part, line] of lines) {
      const points = played?.[part] ?? [];
      line.visible = points.length > 1;
      if (!line.visible) continue;
      // it changes with each view: what the graphics card had of the one before goes
      line.geometry.dispose();
      line.geometry.setPositions(points.flat());
    }
  };
  group.show(null);
  return group;
}

/** Whether the tool is engaged at a point of a path. */
export function isEngaged(segments, k) {
  return Boolean(segments.find((each) => k <= each.tool_path_end)?.engaged);
}

/** Return a ball of a colour that is seen through everything. */
export function markerBall(radius, colour) {
  const ball = new Mesh(new SphereGeometry(radius, 20, 14), new MeshBasicMaterial({color: colour, transparent: true, opacity: 0.75, depthTest: false}));
  ball.renderOrder = 3;
  ball.visible = false;
  return ball;
}

/** Return the axes of a frame as arrows, x red, y green, z blue, so long [m]. */
export function axes(length) {
  const arrow = (axis) => {
    const shaft = new CylinderGeometry(0.035, 0.035, 0.78, 10).translate(0, 0.39, 0);
    const head = new CylinderGeometry(0, 0.095, 0.24, 14).translate(0, 0.88, 0);
    const both = mergeGeometries([shaft, head]);
    if (axis === 0) both.rotateZ(-Math.PI / 2);
    if (axis === 2) both.rotateX(Math.PI / 2);
    const colour = new Color(colours.AXES[axis]);
    both.setAttribute("color", new Float32BufferAttribute(Array.from({length: both.attributes.position.count}, () => colour.toArray()).flat(), 3));
    return both;
  };
  const geometry = mergeGeometries([0, 1, 2].map(arrow)).scale(length, length, length);
  const found = new Mesh(geometry, new MeshBasicMaterial({vertexColors: true}));
  found.name = "axes";
  return found;
}
