/**
 * The frame of the page: header, the line about the connection, and an area per panel.
 *
 * A panel is a module with `make(parent, store, connection, texts)`. It makes its elements once below `parent` and changes them when
 * the store tells something. It shows the robot `store.selected`. An exception in one panel is told in a line, and the others go on.
 */
import {add, button, clear, setText} from "./dom.js";

/** Areas in the order of the document: the one in which a keyboard or a screen reader goes through them. */
export const AREAS = ["status", "picture", "stop", "verdict", "plan", "tasks", "motion", "plots", "runs"];
/** Areas that stand beside the picture where there is room, one below the other: the stop stays in view above the others. */
const BESIDE = ["stop", "verdict", "plan", "tasks"];
/** Areas that can be folded: what must always be there cannot. */
const FOLDING = ["plan", "tasks", "motion", "plots", "runs"];
const OPEN_AT_FIRST = ["plan", "motion"];
/** Areas whose panels are made and told before the others, whatever becomes of those. */
const FIRST = ["stop", "status"];
/** An area that takes no presses any more once it has failed: what it shows may be of another plan. */
const CLOSING = "verdict";

/**
 * Build the frame and the panels in it.
 *
 * @param {Element} parent
 * @param {object} store see store.js
 * @param {object} connection see connection.js
 * @param {Function} texts see texts.js
 * @param {object} panels by area: a module or a list of modules with `make`
 * @param {object} actions `onTheme()`, `onLanguage()`
 * @returns {Object<string, Element>} the areas
 */
export function makePage(parent, store, connection, texts, panels, {onTheme, onLanguage} = {}) {
  const header = add(parent, "header", {className: "header"});
  add(header, "h1", {text: texts("page.title")});
  const robots = add(header, "div", {className: "robots", role: "group", "aria-label": texts("page.robot")});
  const account = add(header, "span", {className: "account"});
  button(header, texts("page.language"), () => onLanguage?.(), {className: "quiet", lang: texts.language === "en" ? "de" : "en"});
  button(header, texts("page.theme"), () => onTheme?.(), {className: "quiet"});
  const logout = button(header, texts("page.logout"), () => connection.logout(), {className: "quiet"});
  const lost = add(parent, "p", {className: "lost", role: "alert", hidden: true});
  const failed = add(parent, "p", {className: "failed", role: "alert", hidden: true});
  const old = add(parent, "p", {className: "old", role: "status", hidden: true});
  const waiting = add(parent, "p", {className: "waiting", text: texts("page.waiting")});
  const refused = add(parent, "p", {className: "refused", role: "status", hidden: true});
  const main = add(parent, "main", {className: "areas"});
  const areas = {};
  let side = null;
  for (const name of AREAS) {
    if (BESIDE.includes(name)) side ??= add(main, "div", {className: "side"});
    const place = BESIDE.includes(name) ? side : main;
    if (FOLDING.includes(name)) {
      const details = add(place, "details", {id: name, className: "area", open: OPEN_AT_FIRST.includes(name)});
      add(add(details, "summary"), "h2", {text: texts(`page.area.${name}`)});
      areas[name] = add(details, "div", {className: "inside"});
    } else {
      areas[name] = add(place, "section", {id: name, className: "area", "aria-label": texts(`page.area.${name}`)});
    }
  }

  const failures = new Set();
  store.on("failed", (_, {part}) => {
    failures.add(part);
    if (part === CLOSING) areas[part].setAttribute("inert", "");
    const parts = [...failures].map((each) => texts(`page.area.${each}`)).join(", ");
    failed.hidden = false;
    setText(failed, texts(failures.has("stop") ? "page.failed_stop" : "page.failed", {parts}));
  });
  for (const name of [...FIRST, ...AREAS.filter((each) => !FIRST.includes(each))]) {
    for (const panel of [panels[name] ?? []].flat()) {
      try {
        panel.make(areas[name], store.of(name), connection, texts);
      } catch (error) {
        store.failed(name, error);
      }
    }
  }

  const showRobots = () => {
    waiting.hidden = store.robots.length > 0;
    main.classList.toggle("empty", store.robots.length === 0);
    clear(robots);
    for (const name of store.robots) {
      button(robots, name, () => store.select(name), {"aria-pressed": String(name === store.selected)});
    }
    showOld();
  };
  const showOld = () => {
    const robot = store.robot(store.selected);
    old.hidden = robot === null || !robot.old || connection.state !== "connected";
    if (!old.hidden) setText(old, texts("page.old", {robot: robot.name}));
    main.classList.toggle("is-old", robot?.old ?? true);
  };
  const showConnection = () => {
    const bad = connection.state !== "connected";
    lost.hidden = !bad;
    main.classList.toggle("is-lost", bad);
    if (bad) {
      const why = `connection.why.${connection.reason}`;
      setText(lost, texts(`connection.${connection.state}`, {why: texts.has(why) ? texts(why) : ""}));
    }
    setText(account, connection.account ? texts("page.account", {account: connection.account}) : texts("page.nobody"));
    logout.hidden = connection.account === "";
    showOld();
  };
  store.on("robots", showRobots);
  store.on("selected", () => {
    refused.hidden = true;
    showRobots();
  });
  store.on("old", showOld);
  store.on("connection", showConnection);
  store.on("refused", (robot, {kind, sentence}) => {
    if (robot !== store.selected) return;
    refused.hidden = false;
    setText(refused, texts("page.refused", {kind, sentence}));
  });
  showRobots();
  showConnection();
  return areas;
}
