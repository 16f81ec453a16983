/**
 * The frame of the page: header, lines about the connection, and an area per panel. It is as high as the screen and
 * does not scroll: sentence, picture and stop are always in view, and what stands in a tab scrolls in itself.
 *
 * A panel is a module with `make(parent, store, connection, texts)`. It makes its elements once below `parent` and
 * changes them when the store tells something. It shows the robot `store.selected`. An exception in one panel is told
 * in a line, and the others go on.
 */
import {add, button, clear, setText} from "./dom.js";
import {whyLost} from "./connection.js";
import {makeTabs} from "./tabs.js";
import {mark} from "./texts.js";

/** Areas that are always there, in the order in which a keyboard or a screen reader goes through them. */
export const ALWAYS = ["status", "picture", "stop"];
/** Areas that share one place beside the picture, a tab each; the first is open at first. */
const TABS = {verdict: mark("Review"), motion: mark("Motion"), plan: mark("Plan"), tasks: mark("Work"), messages: mark("Messages")};
const AREAS = [...ALWAYS, ...Object.keys(TABS)];
/** Names of the areas, and of a failure outside of them. */
const NAMES = {
  status: mark("State"), picture: mark("Picture"), stop: mark("Stop"), verdict: mark("Plan under review"), motion: mark("Joints and tool"),
  plan: mark("Plan a motion"), tasks: mark("Work from the model"), messages: mark("Messages"), page: mark("frame of the page"),
};
/** Areas whose panels are made and told before the others, whatever becomes of those. */
const FIRST = ["stop", "status"];
/** An area that takes no presses any more once it has failed: what it shows may be of another plan. */
const CLOSING = "verdict";

/**
 * Build the frame and the panels in it.
 *
 * @param {object} actions `onTheme()`, `onLanguage()`
 */
export function makePage(parent, store, connection, texts, panels, {onTheme, onLanguage} = {}) {
  const header = add(parent, "header", {className: "header"});
  const robots = add(header, "div", {className: "robots", role: "group", "aria-label": texts("Robot")});
  add(header, "h1", {text: texts("construction_twin console")});
  const account = add(header, "span", {className: "account"});
  const menu = add(header, "details", {className: "menu"});
  const opener = add(menu, "summary", {"aria-label": texts("Menu"), text: "\u2630"});
  const items = add(menu, "div", {className: "menu-items"});
  const item = (text, act, options) => button(items, text, () => {
    menu.open = false;
    act();
  }, options);
  // as menus do: a press anywhere else closes it, and Escape, after which the keyboard is where it was
  const {ownerDocument: page} = menu;
  page.addEventListener("pointerdown", ({target}) => {
    if (menu.open && !menu.contains(target)) menu.open = false;
  }, true);
  page.addEventListener("keydown", (event) => {
    if (event.key !== "Escape" || !menu.open) return;
    menu.open = false;
    opener.focus();
  });
  const who = add(items, "p", {className: "menu-account"});
  item(texts.language === "en" ? "Deutsch" : "English", () => onLanguage?.(), {lang: texts.language === "en" ? "de" : "en"});
  item(texts("Dark or light"), () => onTheme?.());
  const logout = item(texts("Log out"), () => connection.logout());
  const main = add(parent, "main", {className: "areas"});
  // over the picture: nothing may move under a finger, and what to do stays readable
  const notices = add(main, "div", {className: "notices"});
  const lost = add(notices, "p", {className: "lost", role: "alert", hidden: true});
  const failed = add(notices, "p", {className: "failed", role: "alert", hidden: true});
  const old = add(notices, "p", {className: "old", role: "status", hidden: true});
  const waiting = add(notices, "p", {className: "waiting", text: texts("No robot has been heard yet. The page waits for console_node's messages.")});
  const refused = add(notices, "p", {className: "refused", role: "status", hidden: true});
  const section = (name) => add(main, "section", {id: name, className: "area", "aria-label": texts(NAMES[name])});
  const areas = Object.fromEntries(ALWAYS.map((name) => [name, section(name)]));
  Object.assign(areas, makeTabs(main, texts, TABS, section));

  const failures = new Set();
  store.on("failed", (_, {part}) => {
    failures.add(part);
    if (part === CLOSING) areas[part].setAttribute("inert", "");
    const parts = [...failures].map((each) => texts.word(NAMES, each)).join(", ");
    failed.hidden = false;
    setText(failed, failures.has("stop")
      ? texts("THE STOP OF THIS PAGE HAS FAILED ({parts}). Reload the page; if there is danger, use the emergency stop.", {parts})
      : texts("A part of this page has failed ({parts}): what it shows may be wrong or old. Reload the page.", {parts}));
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
    // one robot is named by its picture
    robots.hidden = store.robots.length < 2;
    for (const name of store.robots) {
      button(robots, name, () => store.select(name), {"aria-pressed": String(name === store.selected)});
    }
    showOld();
  };
  const showOld = () => {
    const robot = store.robot(store.selected);
    old.hidden = robot === null || !robot.old || connection.state !== "connected";
    if (!old.hidden) {
      setText(old, texts("Old: nothing was heard from {robot} for more than a second. What is drawn is not the present.", {robot: robot.name}));
    }
    main.classList.toggle("is-old", robot?.old ?? true);
  };
  const showConnection = () => {
    const bad = connection.state !== "connected";
    lost.hidden = !bad;
    main.classList.toggle("is-lost", bad);
    if (bad) setText(lost, whyLost(connection, texts));
    const name = connection.account;
    for (const each of [account, who]) setText(each, name ? texts("Logged in as {account}", {account: name}) : texts("no account"));
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
    setText(refused, texts("A message ({kind}) was not as expected and is not shown: {sentence}", {kind, sentence}));
  });
  showRobots();
  showConnection();
}
