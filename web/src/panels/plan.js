/**
 * Plan a motion: joint sliders, saved poses, the tool's pose as numbers, a straight line.
 *
 * Nothing moves by it: what is asked for becomes a plan under review. Who may ask stands in the list of rights
 * (rights.js); who may not reads who can, in place of sliders. Where there is no list, everything is drawn, and a
 * refusal of the broker is told.
 */
import {add, button, clear, setText} from "../dom.js";
import {showAsking} from "../planning/asking.js";
import {ends, fromShown, isInside, shown, typed, unit} from "../planning/joints.js";
import {LONGEST, Poses} from "../planning/poses.js";
import {whoCan} from "../rights.js";
import {storageOf} from "../storage.js";
import {mark} from "../texts.js";
import {isBusy, makeRequests, outcome} from "../requests.js";
import {browser} from "./clock.js";
import {makeToolFields} from "./tool_fields.js";

/** Fractions of the limits that can be chosen; 0: what the planner has set. */
const SPEEDS = [0, 0.1, 0.25, 0.5, 1];
/** Why a pose is not saved or deleted. */
const NOT_SAVED = {
  name: mark("Give the pose a name first (at most 40 characters)."),
  full: mark("50 poses are saved already. Delete one first."),
  storage: mark("This browser keeps nothing for pages, so the pose was not saved."),
};
/** What the panel knows of one robot. */
class Desk {
  constructor() {
    // what the broker has said to what a person asked for on this connection: "", "taken", "refused"
    this.broker = "";
    // null until the model was read; then as in planning/model.js, and the saved poses
    this.model = null;
    this.poses = null;
    // joint values {name: value}; null: none is set
    this.goal = null;
    this.note = "";
  }
}

/**
 * Make the panel.
 *
 * @param {object} [means] for tests: `storage`, `now()` [s]
 */
export function make(parent, store, connection, texts, {storage = storageOf(), now = () => performance.now() / 1000} = {}) {
  const desks = new Map();
  let shownJoints = null;
  let hasPose = false;

  const told = add(parent, "p", {className: "plan-told", role: "status"});
  const begin = button(parent, texts("Set a goal"), onBegin, {className: "plan-begin"});
  const work = add(parent, "div", {className: "plan-work", hidden: true});
  add(work, "p", {className: "plan-hint",
    text: texts("Nothing moves. What you ask for becomes a plan, which somebody must look at and approve.")});
  const sliders = add(work, "div", {className: "plan-sliders"});
  const wrong = add(work, "p", {className: "plan-wrong", role: "status"});
  const row = add(work, "div", {className: "plan-row"});
  button(row, texts("Back to where the robot is"), onBegin);
  button(row, texts("Discard the goal"), onDiscard, {className: "quiet"});

  const saved = add(work, "fieldset", {className: "plan-poses"});
  add(saved, "legend", {text: texts("Saved poses")});
  const choice = add(saved, "select", {"aria-label": texts("Saved poses")});
  const go = button(saved, texts("Take this pose as goal"), () => usePose(choice.value));
  const remove = button(saved, texts("Delete"), () => removePose(choice.value), {className: "quiet"});
  const nameText = texts("Name of the pose");
  const name = add(saved, "input", {type: "text", maxlength: LONGEST, "aria-label": nameText, placeholder: nameText});
  button(saved, texts("Save the goal"), onSave);
  const note = add(saved, "p", {className: "plan-note", role: "status"});

  const asks = add(work, "div", {className: "plan-row"});
  const speedLabel = add(asks, "label", {text: `${texts("Speed")} `});
  const speed = add(speedLabel, "select");
  for (const fraction of SPEEDS) {
    const text = fraction === 0 ? texts("as set at the planner") : texts("{percent} % of the limits", {percent: Math.round(100 * fraction)});
    add(speed, "option", {value: String(fraction), text});
  }
  const ask = button(asks, texts("Ask for this plan"), () => onAsk("joints"), {className: "plan-ask"});
  const toolFields = makeToolFields(work, texts, (kind, {position, quaternion}) => onAsk(kind, {position, orientation: quaternion}));
  const answer = add(work, "p", {className: "plan-answer", role: "status"});

  function desk(robot) {
    if (!desks.has(robot)) desks.set(robot, new Desk());
    return desks.get(robot);
  }

  function selected() {
    return store.selected === "" ? null : desk(store.selected);
  }

  // -- what the robot is, and whether this account may plan

  function onModel(robot, model) {
    const mine = desk(robot);
    mine.model = model.trouble ? null : model;
    if (mine.model !== null) {
      mine.goal = null;
      mine.poses = new Poses(storage, robot, model.joints);
      if (mine.poses.dropped > 0) mine.note = texts("{count} saved poses do not fit this robot and were left out.", {count: mine.poses.dropped});
    }
    show();
  }

  function mayPlan(robot) {
    return store.rightsOf.may(robot, "operate") !== false && desk(robot).broker !== "refused";
  }

  function presentJoints(robot) {
    const view = store.robot(robot)?.view;
    const pose = view?.twin ?? view?.arm ?? null;
    return pose === null ? null : Object.fromEntries(view.joints.names.map((joint, number) => [joint, pose.positions[number]]));
  }

  // -- the goal

  function onBegin() {
    const present = presentJoints(store.selected);
    if (present === null) return;
    setGoal(present);
  }

  function onDiscard() {
    selected().goal = null;
    store.set("goal", store.selected, null);
    show();
  }

  /** Set the goal to joint values, or say that one is out of range. */
  function setGoal(values) {
    const mine = selected();
    const {joints} = mine.model;
    if (!joints.every((joint) => Number.isFinite(values[joint.name]) && isInside(joint, values[joint.name]))) {
      setText(wrong, texts("This goal is outside of a joint's range, so it was not taken."));
      return;
    }
    setText(wrong, "");
    const names = joints.map((joint) => joint.name);
    mine.goal = Object.fromEntries(names.map((joint) => [joint, values[joint]]));
    store.set("goal", store.selected, {names, positions: names.map((joint) => values[joint])});
    show();
  }

  // -- saved poses

  function onSave() {
    const mine = selected();
    const why = mine.poses.save(name.value, mine.goal);
    mine.note = why === "" ? texts("Saved as {name}, on this device only.", {name: name.value.trim()}) : texts(NOT_SAVED[why]);
    if (why === "") name.value = "";
    show();
  }

  function usePose(pose) {
    const found = selected().poses.find(pose);
    if (found !== null) setGoal(found.joints);
  }

  function removePose(pose) {
    const mine = selected();
    const why = mine.poses.remove(pose);
    mine.note = why === "" ? texts("{name} is deleted.", {name: pose}) : texts(NOT_SAVED[why]);
    show();
  }

  // -- asking

  const requests = makeRequests(store, connection, {now: () => 1000 * now(), every: browser.every}, ["plan_request_ack"], (robot) => {
    if (outcome(requests.of(robot)) === "no_right") desk(robot).broker = "refused";
    show();
  });

  function onAsk(kind, goal = {joints: selected().goal}) {
    const robot = store.selected;
    if (isBusy(requests.of(robot))) return;
    const fraction = Number(speed.value);
    requests.send(robot, "plan_request", {kind, ...goal, ...(fraction > 0 && {speed_scale: fraction})});
  }

  // -- what is shown

  function show() {
    const robot = store.selected;
    const mine = selected();
    const connected = connection.state === "connected";
    const isPlanner = mine !== null && mine.model !== null && mayPlan(robot);
    const hasGoal = isPlanner && mine.goal !== null;
    work.hidden = !hasGoal;
    begin.hidden = !isPlanner || hasGoal;
    hasPose = mine !== null && presentJoints(robot) !== null;
    begin.disabled = !connected || !hasPose;
    setText(told, sentence(robot, mine, connected));
    told.hidden = told.textContent === "";
    if (!hasGoal) return;
    showSliders(mine);
    toolFields.show(mine.model.pose(mine.goal));
    showPoses(mine);
    ask.disabled = !connected || (store.robot(robot)?.old ?? true) || isBusy(requests.of(robot));
    toolFields.disable(ask.disabled);
    showAsking(answer, requests.of(robot), store.robot(robot)?.plan?.id ?? "", connection.account, texts);
  }

  function sentence(robot, mine, connected) {
    if (mine === null || !connected) return texts("Not connected: nothing can be asked for.");
    if (!mayPlan(robot)) return whoPlans(robot);
    const trouble = store.robot(robot)?.model?.trouble;
    if (trouble) return texts("The robot's model could not be loaded ({why}), so no goal can be set here.", {why: trouble});
    if (mine.model === null) return texts("Loading the robot's model ...");
    return hasPose ? "" : texts("Where the robot is, is not known, so no goal can be set.");
  }

  function whoPlans(robot) {
    const who = store.rightsOf.who(robot, "operate");
    const isListed = who.length > 0 || store.rightsOf.may(robot, "operate") === false;
    return isListed ? `${texts("This account may not ask for plans.")} ${whoCan(who, texts)}`
      : texts("The account {account} may look, and may not ask for plans: the broker has refused it. "
        + "Whoever looks after the site's accounts can give you one with the right operate.", {account: connection.account || "-"});
  }

  function showSliders(mine) {
    if (shownJoints !== mine.model.joints) {
      shownJoints = mine.model.joints;
      clear(sliders);
      for (const joint of shownJoints) makeSlider(joint);
    }
    shownJoints.forEach((joint, number) => {
      const value = shown(joint, mine.goal[joint.name]);
      const [slider, field] = sliders.children[number].querySelectorAll("input");
      const document = sliders.ownerDocument;
      if (document.activeElement !== slider || Math.abs(Number(slider.value) - value) > 0.051) slider.value = String(value);
      if (document.activeElement !== field) {
        field.value = value.toFixed(1);
        field.removeAttribute("aria-invalid");
      }
    });
  }

  function makeSlider(joint) {
    const line_ = add(sliders, "div", {className: "plan-joint"});
    const {min, max, step} = ends(joint);
    const label = texts("{joint}, {min} to {max} {unit}", {joint: joint.name, min, max, unit: unit(joint)});
    add(line_, "span", {className: "plan-joint-name", text: joint.name});
    const slider = add(line_, "input", {type: "range", min, max, step, "aria-label": label});
    const field = add(line_, "input", {type: "text", inputmode: "text", size: 7, "aria-label": label});
    add(line_, "span", {text: unit(joint)});
    slider.addEventListener("input", () => {
      const value = Math.min(joint.upper, Math.max(joint.lower, fromShown(joint, Number(slider.value))));
      setGoal({...selected().goal, [joint.name]: value});
    });
    field.addEventListener("change", () => {
      const value = typed(joint, field.value);
      if (value === null) {
        field.setAttribute("aria-invalid", "true");
        setText(wrong, texts("{joint} goes from {min} to {max} {unit}. Write a number in between.", {joint: joint.name, min, max, unit: unit(joint)}));
        return;
      }
      field.removeAttribute("aria-invalid");
      setGoal({...selected().goal, [joint.name]: value});
    });
  }

  function showPoses(mine) {
    const {list} = mine.poses;
    const present = [...choice.children].map((option) => option.value);
    if (present.length !== list.length || list.some((pose, number) => pose.name !== present[number])) {
      clear(choice);
      for (const pose of list) add(choice, "option", {value: pose.name, text: pose.name});
    }
    choice.hidden = list.length === 0;
    go.hidden = choice.hidden;
    remove.hidden = choice.hidden;
    setText(note, mine.note);
  }

  // -- what the others tell

  store.on("view", (robot) => {
    if (robot === store.selected && hasPose !== (presentJoints(robot) !== null)) show();
  });
  for (const kind of ["selected", "old", "rights"]) store.on(kind, show);
  store.on("model", onModel);
  store.on("plan", show);
  store.on("connection", () => {
    for (const mine of desks.values()) mine.broker = "";
    show();
  });
  show();
}
