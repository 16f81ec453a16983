/**
 * Feeds changed messages to what the page keeps of the broker's messages: `node fuzz_page.mjs COUNT SEED`.
 *
 * Whatever comes in is taken or refused and counted; nothing throws, and what is kept stays what the panels may rely on. Prints one
 * JSON object: how many inputs ended how.
 */
import {makeStore} from "../../web/src/store.js";

const count = Number(process.argv[2]);
let state = Number(process.argv[3]) >>> 0;

/** mulberry32: the same seed, the same inputs. */
function random() {
  state = (state + 0x6d2b79f5) >>> 0;
  let t = Math.imul(state ^ (state >>> 15), 1 | state);
  t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
  return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
}
const choice = (items) => items[Math.floor(random() * items.length)];

const VALUES = [null, true, 0, -1, 1.5, 1e308, 2 ** 60, "", "x".repeat(2000), [], {}, [[]], [null], {positions: [1e999]}, "\u0000"];
const PARTS = ["{", "}", "[", "]", ",", '"', "\\", "NaN", "1e999", "\u0000", "[".repeat(1500), "9".repeat(400), "null", "\ud800"];
const POSE = {stamp: 1, age: 0, positions: [0, 0]};
let seq = 0;
const samples = () => [
  ["view", {version: 2, run: "run", seq: (seq += 1), online: true, stamp: 1, joints: {names: ["joint_a1", "joint_a2"], types: ["revolute", "revolute"]},
    twin: POSE, arm: POSE, sync: {state: "IN_SYNC", reason: "", error: [0, 0]}, link: {state: "ARMED", reason: ""},
    execution: {state: "IDLE", reason: ""}, plan: "", closest: null}],
  ["screen", [{topic: "execution", state: "IDLE", sentence: "The arm stands still.", waits_for: "", who: "", todo: "", page: "", level: 0}]],
  ["scene", {hash: "0", frame: "base_link", objects: [{name: "table", shape: "box", size: [1, 1, 1]}]}],
  ["plan", {id: "p1", hash: "0".repeat(64), joints: ["joint_a1"], trajectory: {times: [0, 1], positions: [[0], [1]],
    velocities: [[0], [0]], accelerations: [[0], [0]]}}],
  ["path", {plan_id: "p1", times: [0, 1], tool_path: [[0, 0, 1], [1, 0, 1]]}],
  ["work/tasks", {model: "m", model_hash: "0", tasks: [{id: "1", element: "2", title: "Place", state: "ready"}]}],
  ["review/ack", {plan_id: "p1", plan_hash: "", ok: false, reason: "", account: ""}],
  ["stop/ack", {id: "1", account: "a", by: "gateway", ok: true, reason: ""}],
  ["pause/ack", {id: "1", account: "a", by: "executor", ok: true, reason: ""}],
  ["plan_request/ack", {id: "1", account: "a", kind: "joints", ok: false, reason: ""}],
  ["ik/ack/console", {id: "1", reach: "free", joints: {joint_a1: 0}}],
];

/** Change a value somewhere inside; one in four also takes a key away. */
function changeInside(value) {
  let at = value;
  for (;;) {
    const keys = Object.keys(at);
    if (keys.length === 0) return;
    const key = choice(keys);
    if (typeof at[key] === "object" && at[key] !== null && random() < 0.7) {
      at = at[key];
    } else {
      if (random() < 0.25 && !Array.isArray(at)) delete at[key];
      else at[key] = structuredClone(choice(VALUES));
      return;
    }
  }
}

function changeText(text) {
  const at = Math.floor(random() * (text.length + 1));
  if (random() < 0.5) return text.slice(0, at) + choice(PARTS) + text.slice(at);
  return text.slice(0, at) + text.slice(at + Math.floor(random() * 9));
}

const isFinite_ = (values) => values.every(Number.isFinite);
let time = 0;
const store = makeStore({now: () => (time += 1)});
const tally = {accepted: 0, refused: 0};
let told = 0;
for (const kind of ["view", "screen", "scene", "plan", "path", "tasks", "review_ack", "stop_ack", "pause_ack", "plan_request_ack", "ik_ack"]) {
  store.on(kind, () => {
    told += 1;
  });
}
for (let done = 0; done < count; done += 1) {
  const [topic, sample] = choice(samples());
  const value = structuredClone(sample);
  for (let k = 0; k < 1 + 3 * random(); k += 1) changeInside(value);
  let text = JSON.stringify(value);
  if (random() < 0.3) text = changeText(text);
  const before = store.refused;
  await store.take(`robot_${Math.floor(random() * 40)}`, topic, text, random() < 0.02);
  tally[store.refused > before ? "refused" : "accepted"] += 1;
  if (store.robots.length > 32) throw new Error(`${store.robots.length} robots are kept`);
  if (done % 100 === 0) store.tick();
}
for (const name of store.robots) {
  const {view: kept, screen, plan} = store.robot(name);
  for (const pose of kept === null ? [] : [kept.twin, kept.arm]) {
    if (pose !== null && !(isFinite_(pose.positions) && pose.positions.length === kept.joints.names.length)) throw new Error("a pose that is none was kept");
  }
  if (screen !== null && !screen.every((line) => typeof line.sentence === "string")) throw new Error("a line without a sentence was kept");
  // no sample has the hash of its motion
  if (plan !== null && plan.refused === "") throw new Error("a plan was taken whose hash is another");
}
if (told === 0) throw new Error("nothing came through: the samples are not the page's messages any more");
console.log(JSON.stringify(tally));
