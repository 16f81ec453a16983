/** Objects of the scene, the building model, lines and markers. Metres, in base_link. */
import {
  BoxGeometry, BufferGeometry, Color, CylinderGeometry, DoubleSide, Float32BufferAttribute, Group, LineSegments, Mesh, MeshBasicMaterial,
  MeshLambertMaterial, SphereGeometry, LineBasicMaterial,
} from "three";
import {GLTFLoader} from "three/addons/loaders/GLTFLoader.js";
import {Line2} from "three/addons/lines/Line2.js";
import {LineGeometry} from "three/addons/lines/LineGeometry.js";
import {LineMaterial} from "three/addons/lines/LineMaterial.js";
import * as colours from "./colours.js";
import {fetchOwn, loadMesh} from "./robot_model.js";
import {stateOfElement} from "../work/task_list.js";

/** Free what a group holds on the graphics card. */
export function dispose(object) {
  object.traverse((child) => {
    child.geometry?.dispose();
    for (const material of [child.material ?? []].flat()) material.dispose();
  });
  object.removeFromParent();
}

/**
 * Return a translucent material for a ghost.
 *
 * @param {number} colour
 * @param {number} opacity
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

const isVector = (value, length) => Array.isArray(value) && value.length === length && value.every(Number.isFinite);

/**
 * Return the body of an object of the scene, in its own frame at its pose; its mesh comes when it has been loaded.
 *
 * @param {object} object of the scene's message
 * @param {() => void} onChange called when a mesh has come
 */
export function sceneBody(object, onChange) {
  const carried = Boolean(object.link);
  const material = new MeshLambertMaterial({
    color: carried ? colours.CARRIED : colours.STANDING, transparent: !carried, opacity: carried ? 1 : 0.55, side: DoubleSide,
    depthWrite: carried,
  });
  const group = new Group();
  group.name = object.name;
  if (isVector(object.position, 3)) group.position.fromArray(object.position);
  if (isVector(object.orientation, 4)) group.quaternion.fromArray(object.orientation);
  group.userData.object = object.name;
  const geometry = isVector(object.size, object.size?.length ?? -1) ? geometryOf(object) : null;
  if (geometry !== null) {
    group.add(new Mesh(geometry, material));
  } else if (object.shape === "mesh" && /^[0-9a-f]{64}$/.test(object.mesh)) {
    loadMesh(`/private/mesh/${object.mesh}.stl`, material).then((mesh) => {
      if (isVector(object.size, 3)) mesh.scale.fromArray(object.size);
      group.add(mesh);
      onChange();
    }, (error) => onChange(error));
  }
  return group;
}

/**
 * Return the building model in base_link; glTF has Y up. Its elements are found by `userData.element`; `hash` is of the model that it
 * was made from, "" for a file that does not say.
 */
export async function loadBuilding(url) {
  const bytes = await fetchOwn(url, (answer) => answer.arrayBuffer());
  const {scene, asset} = await new GLTFLoader().parseAsync(bytes, "");
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

/**
 * Return the planned path of the tool as a line, with a marker at each end.
 *
 * @param {number[][]} points [m]
 * @param {{tool_path_end: number, engaged: boolean}[]} segments of a work plan: where the tool is engaged has another colour
 */
export function pathLine(points, segments = []) {
  const group = new Group();
  const usable = points.filter((point) => isVector(point, 3));
  if (usable.length < 2) return group;
  const geometry = new LineGeometry();
  geometry.setPositions(usable.flat());
  geometry.setColors(usable.flatMap((point, k) => {
    const segment = segments.find((each) => k <= each.tool_path_end);
    const colour = segment?.engaged ? colours.PATH_ENGAGED : colours.PATH;
    return new Color(colour).toArray();
  }));
  group.add(new Line2(geometry, new LineMaterial({linewidth: 4, vertexColors: true})));
  const ends = [usable[0], ...segments.map((each) => usable[each.tool_path_end]).filter(Boolean), usable.at(-1)];
  for (const end of ends) {
    const marker = new Mesh(new SphereGeometry(0.018, 12, 8), new MeshBasicMaterial({color: colours.PATH}));
    marker.position.fromArray(end);
    group.add(marker);
  }
  return group;
}

/**
 * Return the marker of the closest point: a dot, and a sphere of the distance as radius around it, which touches what is near; with
 * a second point a line between both.
 */
export function closestMarker() {
  const group = new Group();
  const dot = new Mesh(new SphereGeometry(0.015, 12, 8), new MeshBasicMaterial({color: colours.CLOSEST, depthTest: false}));
  const ball = new Mesh(new SphereGeometry(1, 24, 16),
    new MeshBasicMaterial({color: colours.CLOSEST, transparent: true, opacity: 0.18, depthWrite: false}));
  const geometry = new LineGeometry();
  geometry.setPositions([0, 0, 0, 0, 0, 0]);
  const line = new Line2(geometry, new LineMaterial({color: colours.CLOSEST, linewidth: 3, depthTest: false}));
  dot.renderOrder = 2;
  line.renderOrder = 2;
  line.frustumCulled = false;
  group.add(dot, ball, line);
  group.visible = false;
  /** Show what the view says; null: nothing. */
  group.show = (closest) => {
    group.visible = isVector(closest?.point, 3) && Number.isFinite(closest.distance);
    if (!group.visible) return;
    dot.position.fromArray(closest.point);
    ball.position.copy(dot.position);
    // far bodies are no news, and their sphere would fill the picture
    ball.visible = closest.distance > 0 && closest.distance < 0.5;
    ball.scale.setScalar(Math.max(closest.distance, 1e-3));
    line.visible = isVector(closest.other, 3);
    if (line.visible) geometry.setPositions([...closest.point, ...closest.other]);
  };
  return group;
}

/** Return a grid on the floor: squares of one metre. */
export function floor(colour, half = 5) {
  const points = [];
  for (let k = -half; k <= half; k += 1) points.push(k, -half, 0, k, half, 0, -half, k, 0, half, k, 0);
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new Float32BufferAttribute(points, 3));
  return new LineSegments(geometry, new LineBasicMaterial({color: colour, transparent: true, opacity: 0.5}));
}

/** Return a ball that marks whether a goal can be reached. */
export function reachMarker() {
  const marker = new Mesh(new SphereGeometry(0.05, 20, 14), new MeshBasicMaterial({transparent: true, opacity: 0.75, depthTest: false}));
  marker.renderOrder = 3;
  marker.visible = false;
  return marker;
}
