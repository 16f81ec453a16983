/**
 * While a plan is under way: whose it is, how far it has come, what remains, and how fast it goes. Stands above the
 * verdict; the numbers come with each view and are shown ten times a second at most.
 */
import {add, setText} from "../dom.js";
import {clock, percentOf, progressOf} from "../progress.js";
import {browser} from "./clock.js";

const EVERY = 100;
/** Plans whose names are kept per robot: what is played was under review before, and is taken from there by then. */
const MOST = 8;

export function make(parent, store, connection, texts, {every} = browser) {
  const area = add(parent, "div", {className: "progress", hidden: true});
  const name = add(area, "p", {className: "progress-name"});
  const bar = add(area, "div", {className: "progress-bar", role: "progressbar", "aria-valuemin": "0", "aria-valuemax": "100"});
  add(bar, "span", {className: "progress-fill"});
  const percent = add(area, "span", {className: "progress-percent"});
  const left = add(area, "span", {className: "progress-left"});
  const speed = add(area, "span", {className: "progress-speed"});
  const names = new Map();
  let dirty = true;

  const titleOf = (robot, {id, segment}) => {
    const known = names.get(robot)?.get(id);
    const task = known?.task ? store.robot(robot).tasks?.tasks.find((each) => each.id === known.task)?.name || known.task : "";
    const title = known === undefined ? `Plan ${id.slice(0, 8)}`
      : task ? texts("Plan of the task {task}", {task}) : texts("Plan by {source}", {source: texts.reason(known.source)});
    return segment === null ? title : texts("{title}, segment {number}: {name}", {title, number: segment.number + 1, name: segment.name});
  };

  const show = () => {
    dirty = false;
    const robot = store.robot(store.selected);
    const now = progressOf(robot?.view?.execution ?? null);
    area.hidden = now === null;
    if (now === null) return;
    const title = titleOf(robot.name, now);
    setText(name, title);
    const whole = percentOf(now.progress);
    if (bar.getAttribute("aria-valuenow") !== String(whole)) bar.setAttribute("aria-valuenow", String(whole));
    if (bar.getAttribute("aria-label") !== title) bar.setAttribute("aria-label", title);
    bar.style.setProperty("--done", now.progress.toFixed(3));
    setText(percent, `${whole} %`);
    setText(left, now.remaining === null ? texts("stands, {time} of the plan left", {time: clock(now.left)})
      : texts("{time} left", {time: clock(now.remaining)}));
    const values = {speed: now.speed === null ? "-" : Math.round(100 * now.speed), limit: now.limit === null ? "-" : Math.round(100 * now.limit)};
    setText(speed, texts("speed {speed} %, limit {limit} %", values));
  };

  store.on("plan", (robot, plan) => {
    if (plan === null) return;
    const mine = names.get(robot) ?? new Map();
    mine.delete(plan.id);
    mine.set(plan.id, {task: plan.task ?? "", source: plan.source});
    while (mine.size > MOST) mine.delete(mine.keys().next().value);
    names.set(robot, mine);
  });
  store.on("view", (robot) => {
    if (robot === store.selected) dirty = true;
  });
  for (const kind of ["selected", "connection"]) store.on(kind, show);
  every(EVERY, () => {
    if (dirty) show();
  });
  show();
}
