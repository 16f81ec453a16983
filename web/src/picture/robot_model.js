/**
 * The robot's shapes: URDF and meshes as the console serves them, loaded once per robot, then copied for twin, arm, goal and plan.
 *
 * Copies share their geometries; each has materials of its own.
 */
import {Group, Mesh, MeshLambertMaterial, Triangle} from "three";
import {mergeVertices} from "three/addons/utils/BufferGeometryUtils.js";
import URDFLoader from "urdf-loader";

/** Why a model cannot be drawn; `message` is for a person who knows computers. */
export class ModelError extends Error {}

/** Get a file of this server; only its own are asked for, whatever a URDF says. */
export async function fetchOwn(url, read) {
  const address = new URL(url, location.href);
  if (address.origin !== location.origin) throw new ModelError(`${url} is on another server`);
  let answer;
  try {
    answer = await fetch(address, {credentials: "same-origin"});
  } catch (error) {
    throw new ModelError(`${address.pathname}: ${error.message}`);
  }
  if (!answer.ok) throw new ModelError(`${address.pathname}: ${answer.status}`);
  return read(answer);
}

/** Whoever reads a large file waits for who does so already, and lets the page react in between: a stop is tapped at any time. */
let reading = Promise.resolve();
function oneAfterTheOther() {
  reading = reading.then(() => new Promise((resolve) => {
    setTimeout(resolve);
  }));
  return reading;
}

const asText = (bytes) => new TextDecoder().decode(bytes);

/** Return scene and asset of a GLB file. */
export async function readGlb(bytes) {
  const {GLTFLoader} = await import("three/addons/loaders/GLTFLoader.js");
  return new GLTFLoader().parseAsync(bytes, "");
}

/**
 * What reads a mesh file, by its ending: from its bytes to a three object in the file's own axes, as rviz takes them. A
 * reader is loaded when a robot has such a file.
 */
const READERS = {
  ".dae": async (bytes) => {
    const {ColladaLoader} = await import("three/addons/loaders/ColladaLoader.js");
    const {scene} = quietly(() => new ColladaLoader().parse(asText(bytes), ""));
    scene.quaternion.identity();
    return new Group().add(scene);
  },
  ".glb": async (bytes) => (await readGlb(bytes)).scene,
  ".obj": async (bytes) => {
    const {OBJLoader} = await import("three/addons/loaders/OBJLoader.js");
    return new OBJLoader().parse(asText(bytes));
  },
  ".stl": async (bytes, material) => {
    const {STLLoader} = await import("three/addons/loaders/STLLoader.js");
    return new Mesh(new STLLoader().parse(bytes), material);
  },
};

/** Return the meshes of a file as a three object. */
export async function loadMesh(url, material) {
  const read = READERS[url.slice(url.lastIndexOf(".")).toLowerCase()];
  if (read === undefined) throw new ModelError(`${url}: expected one of ${Object.keys(READERS).join(", ")}`);
  const bytes = await fetchOwn(url, (answer) => answer.arrayBuffer());
  await oneAfterTheOther();
  try {
    const object = await read(bytes, material);
    object.traverse(shareCorners);
    return object;
  } catch (error) {
    throw new ModelError(`${url}: ${error.message}`);
  }
}

/** Return why something could not be loaded: a file that is there and cannot be read throws what its reader likes. */
export const reasonOf = (error) => error instanceof ModelError ? error.message : `${error.name}: ${error.message}`;

/** The readers give each triangle three corners of its own: a third to a sixth of them is drawn as well, several times as fast. */
function shareCorners(object) {
  if (!object.isMesh) return;
  // nothing here is drawn with a texture, and two corners differ by what is not drawn otherwise
  for (const name of ["uv", "uv1", "uv2", "uv3"]) object.geometry.deleteAttribute(name);
  const merged = mergeVertices(object.geometry);
  object.geometry.dispose();
  object.geometry = merged;
}

/** The Collada reader tells of every file, and warns of Z up, which all of ROS's have: it is rotated back above. */
function quietly(read) {
  const {warn, debug} = console;
  Object.assign(console, {warn() {}, debug() {}});
  try {
    return read();
  } finally {
    Object.assign(console, {warn, debug});
  }
}

/**
 * Read a URDF.
 *
 * @param {string} here address that its meshes are relative to
 * @param {object} [options] of the reader
 * @returns {{robot: URDFRobot, wanted: {path: string, material: Material, done: Function}[]}} the meshes that belong into it
 */
export function parseRobot(text, here, options = {}) {
  if (!/<robot[\s>]/.test(text)) throw new ModelError("the robot's model is no URDF");
  const wanted = [];
  const loader = Object.assign(new URDFLoader(), {
    parseCollision: false,
    loadMeshCb: (path, manager, material, done) => wanted.push({path: new URL(path, here).href, material, done}),
    packages: (name) => {
      throw new ModelError(`a mesh of the package ${name}: expected an address on this server`);
    },
    ...options,
  });
  const robot = loader.parse(text);
  // where an arm stands is shown, also where it should not be
  for (const joint of Object.values(robot.joints)) joint.ignoreLimits = true;
  return {robot, wanted};
}

/**
 * Load a robot.
 *
 * @param {string} url of its URDF, whose meshes are addresses on this server, relative to it
 * @returns {Promise<{robot: URDFRobot, lacks: string[]}>} with its meshes, and why some are missing; without any it fails
 */
export async function loadRobot(url, onProgress) {
  const text = await fetchOwn(url, (answer) => answer.text());
  const {robot, wanted} = parseRobot(text, new URL(url, location.href));
  // the colours of a URDF are meant as they are on a screen, in rviz as well; its reader takes them for amounts of light
  const own = new Set(wanted.map(({material}) => material));
  robot.traverse((child) => {
    if (child.isMesh) own.add(child.material);
  });
  for (const material of own) material.color.convertSRGBToLinear();
  let done = 0;
  onProgress(0, wanted.length);
  // the same file may be drawn several times
  const files = new Map();
  const lacks = new Map();
  await Promise.all(wanted.map(async (each) => {
    if (!files.has(each.path)) files.set(each.path, loadMesh(each.path, each.material));
    try {
      const mesh = (await files.get(each.path)).clone();
      mesh.traverse((child) => {
        // what the URDF says counts, as in rviz
        if (child.isMesh && each.material.name) child.material = each.material;
      });
      each.done(mesh);
    } catch (error) {
      lacks.set(each.path, error);
    }
    done += 1;
    onProgress(done, wanted.length);
  }));
  if (files.size > 0 && lacks.size === files.size) throw lacks.values().next().value;
  robot.traverse((child) => {
    if (child.isMesh) child.material = plain(child.material);
    // the Collada reader adds lights that a program for drawing wrote into its file
    if (child.isLight || child.isCamera) child.visible = false;
  });
  return {robot, lacks: [...lacks.values()].map(reasonOf).sort()};
}

function plain(material) {
  const first = Array.isArray(material) ? material[0] : material;
  return new MeshLambertMaterial({color: first.color, opacity: first.opacity, transparent: first.transparent});
}

/** Return a copy of a robot in which all is drawn with one material. */
export function ghostOf(robot, material) {
  const ghost = robot.clone();
  ghost.traverse((child) => {
    if (child.isMesh) child.material = material;
  });
  return ghost;
}

/** Set joint values [rad, m] by name; return the names that the robot does not have. */
export function setJoints(robot, names, positions) {
  const missing = [];
  for (let k = 0; k < names.length; k += 1) {
    const joint = robot.joints[names[k]];
    if (joint === undefined) missing.push(names[k]);
    else joint.setJointValue(positions[k]);
  }
  return missing;
}

/** Return the link whose pose is the tool's: tool0, with the prefix that a model may have, else the last of the chain of links. */
export function toolOf(robot) {
  const named = robot.links.tool0 ?? Object.values(robot.links).find(({name}) => name.endsWith("tool0"));
  if (named !== undefined) return named;
  let last = robot;
  let deepest = -1;
  for (const link of Object.values(robot.links)) {
    let depth = 0;
    for (let each = link; each.parent !== null; each = each.parent) depth += 1;
    if (depth > deepest) [last, deepest] = [link, depth];
  }
  return last;
}

/**
 * Return how far the tool gets from the base at most [m], by the lengths of the chain to it: what comes before the
 * second joint that moves stands upright, and is not counted.
 */
export function reachOf(robot) {
  let reach = 0;
  let moving = 0;
  const chain = [];
  for (let each = toolOf(robot); each && each !== robot; each = each.parent) if (each.isURDFJoint) chain.unshift(each);
  for (const joint of chain) {
    if (moving >= 2) reach += (joint.origPosition ?? joint.position).length();
    if (joint.jointType === "revolute" || joint.jointType === "continuous") moving += 1;
  }
  return reach;
}

/** Every so many triangles of a mesh are measured: what a person sees of a robot does not hang on a screw. */
const EVERY = 7;

/** Return the colour of the largest part of a robot's surface: the one that a person knows it by. */
export function mainColour(robot) {
  const areas = new Map();
  const triangle = new Triangle();
  robot.traverse((child) => {
    if (!child.isMesh) return;
    const {index, attributes: {position}} = child.geometry;
    const colour = child.material.color.getHex();
    let area = areas.get(colour) ?? 0;
    for (let k = 0; k + 2 < (index ?? position).count; k += 3 * EVERY) {
      const corners = [k, k + 1, k + 2].map((each) => (index ? index.getX(each) : each));
      area += triangle.setFromAttributeAndIndices(position, ...corners).getArea();
    }
    areas.set(colour, area);
  });
  return [...areas].sort(([, one], [, other]) => other - one)[0]?.[0] ?? null;
}
