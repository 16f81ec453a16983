// The goal that a person makes: joint values, from sliders or from where the tool was dragged. Pure.

import {isInside} from "./joints.js";

// What a planner says of a goal; another word says nothing.
const REACHES = ["free", "contact", "out"];

export class Goal {
  // joints: as from `limits`
  constructor(joints) {
    this.joints = joints;
    this.clear();
  }

  clear() {
    this.values = null;
    // of the tool, only while the goal comes from it
    this.pose = null;
    // what is known of the goal: "unknown" until the planner has said "free", "contact" or "out"
    this.reach = "unknown";
    this.sentence = "";
  }

  // Take joint values {name: value}; returns whether they were complete and inside the limits.
  setJoints(values) {
    if (!isComplete(this.joints, values)) return false;
    this.values = Object.fromEntries(this.joints.map(({name}) => [name, values[name]]));
    this.pose = null;
    this.reach = "unknown";
    this.sentence = "";
    return true;
  }

  // Take what the planner said of a pose of the tool. Without joint values, or with another word than REACHES, the last
  // ones stay to be seen, and cannot be asked for.
  setAnswer(pose, {reach, joints, sentence}) {
    const solved = joints !== null && isComplete(this.joints, joints);
    if (solved) this.values = Object.fromEntries(this.joints.map(({name}) => [name, joints[name]]));
    this.pose = pose;
    this.reach = REACHES.includes(reach) && (solved || reach === "out") ? reach : "unknown";
    this.sentence = typeof sentence === "string" ? sentence : "";
  }

  // Whether a plan to it can be asked for.
  get isAskable() {
    return this.values !== null && this.reach !== "out" && (this.pose === null || this.reach !== "unknown");
  }
}

function isComplete(joints, values) {
  return joints.every((joint) => {
    const value = values[joint.name];
    return typeof value === "number" && Number.isFinite(value) && isInside(joint, value);
  });
}
