// Saved poses, by name and robot, in this browser only. What is read is checked: it may be of another version, or broken.

import {remember, remembered} from "../storage.js";
import {isInside} from "./joints.js";

export const MOST = 50;
export const LONGEST = 40;
const KEY = "construction_twin.poses.";

export class Poses {
  // storage: localStorage, or what behaves as it; null: nothing is kept
  constructor(storage, robot, joints) {
    this._storage = storage;
    this._key = KEY + robot;
    this._joints = joints;
    const {poses, dropped} = read(remembered(this._key, storage), joints);
    this.list = poses;
    // how many could not be used: not of these joints, outside of their limits, or not readable
    this.dropped = dropped;
  }

  // Keep joint values {name: value} under a name, in the place of an older one of that name.
  // Returns "" or why not: "name", "full", "storage".
  save(name, values) {
    const plain = name.trim();
    if (!isName(plain)) return "name";
    const others = this.list.filter((pose) => pose.name !== plain);
    if (others.length >= MOST) return "full";
    const joints = Object.fromEntries(this._joints.map((joint) => [joint.name, values[joint.name]]));
    return this._keep([...others, {name: plain, joints}].sort((one, other) => one.name.localeCompare(other.name)));
  }

  remove(name) {
    return this._keep(this.list.filter((pose) => pose.name !== name));
  }

  find(name) {
    return this.list.find((pose) => pose.name === name) ?? null;
  }

  _keep(list) {
    if (!remember(this._key, JSON.stringify(list), this._storage)) return "storage";
    this.list = list;
    return "";
  }
}

// Return the poses of a stored text that fit the joints, and how many did not.
export function read(text, joints) {
  if (text === null) return {poses: [], dropped: 0};
  let stored;
  try {
    stored = JSON.parse(text);
  } catch {
    return {poses: [], dropped: 1};
  }
  if (!Array.isArray(stored)) return {poses: [], dropped: 1};
  const poses = [];
  const names = new Set();
  for (const entry of stored) {
    if (poses.length < MOST && isPose(entry, joints) && !names.has(entry.name)) {
      names.add(entry.name);
      poses.push({name: entry.name, joints: Object.fromEntries(joints.map(({name}) => [name, entry.joints[name]]))});
    }
  }
  return {poses, dropped: stored.length - poses.length};
}

function isPose(entry, joints) {
  if (typeof entry !== "object" || entry === null || !isName(entry.name)) return false;
  const values = entry.joints;
  if (typeof values !== "object" || values === null || Object.keys(values).length !== joints.length) return false;
  return joints.every((joint) => typeof values[joint.name] === "number" && isInside(joint, values[joint.name]));
}

function isName(name) {
  return typeof name === "string" && name.length >= 1 && name.length <= LONGEST && name === name.trim() && !/\p{Cc}/u.test(name);
}
