/** The waypoints of the plan under review as numbers, in a table that is made when it is opened. Only of a plan whose hash was checked. */
import {add, clear, setText} from "../dom.js";
import {shortNames} from "../planning/model.js";
import {waypointsOf} from "../planning/waypoints.js";

export function make(parent, store, connection, texts) {
  const details = add(parent, "details", {className: "waypoints", hidden: true});
  add(details, "summary", {text: texts("Waypoints as numbers")});
  const caption = add(details, "p", {className: "waypoints-caption"});
  const box = add(details, "div", {className: "waypoints-box", tabindex: "0", role: "region", "aria-label": texts("Waypoints as numbers")});
  let made = "";

  const usable = () => {
    const plan = store.robot(store.selected)?.plan ?? null;
    return plan !== null && plan.refused === "" && plan.trajectory ? plan : null;
  };

  const build = (plan) => {
    const view = store.robot(store.selected).view;
    const types = plan.joints.map((name) => view?.joints.types[view.joints.names.indexOf(name)] ?? "revolute");
    const {names, units, rows, step, all} = waypointsOf(plan, types);
    setText(caption, step > 1 ? texts("One in {step} of {all} waypoints, and the last.", {step, all}) : texts("All {all} waypoints.", {all}));
    clear(box);
    const table = add(box, "table");
    const head = add(add(table, "thead"), "tr");
    add(head, "th", {scope: "col", text: texts("Time [s]")});
    shortNames(names).forEach((name, k) => add(head, "th", {scope: "col", text: `${name} [${units[k]}]`, title: names[k]}));
    const body = add(table, "tbody");
    for (const [time, ...values] of rows) {
      const row = add(body, "tr");
      add(row, "th", {scope: "row", text: time});
      for (const value of values) add(row, "td", {text: value});
    }
  };

  const show = () => {
    const plan = usable();
    const key = plan === null ? "" : `${store.selected}\n${plan.hash}`;
    details.hidden = plan === null;
    if (key === made) return;
    // another plan: it is opened anew
    details.removeAttribute("open");
    clear(box);
    made = "";
  };

  details.addEventListener("toggle", () => {
    const plan = usable();
    if (!details.hasAttribute("open") || plan === null || made !== "") return;
    build(plan);
    made = `${store.selected}\n${plan.hash}`;
  });
  store.on("plan", (robot) => {
    if (robot === store.selected) show();
  });
  store.on("selected", show);
  show();
}
