/**
 * The status line: what the arm does, what is waited for, by whom, and what to do. The robot's sentences (`screen`),
 * worst first, in the page's language, each with its page of the docs; and the page's own, where it hears nothing.
 */
import {add, clear, setText} from "../dom.js";
import {mark} from "../texts.js";
import {browser} from "./clock.js";

/** `screen` comes every second; older sentences [ms] are no longer the present. */
export const SCREEN_OLD_AFTER = 3000;
/** A page of the docs, below docs/: nothing that leads elsewhere. */
const PAGE = /^(?:[\w-]+\/)*[\w-]+\.md(?:#[\w-]+)?$/;

/** Sizes of the sentence, the first that fits. */
const SIZES = ["1.25rem", "1.1rem", "1rem", "0.9rem", "0.8rem", "0.72rem"];
/** Topics whose line, where a person is waited for, tells of a fault. */
const FAULTS = ["cause", "link", "sync"];
const TOPICS = {
  cause: mark("Why it holds"), startup: mark("Start"), link: mark("Link to the arm"), sync: mark("Twin and arm"),
  execution: mark("Motion"), work: mark("Work"), person: mark("People"),
};
const WHO = {
  system: mark("goes on by itself"), operator: mark("a person at the cell"), reviewer: mark("a person who may approve"),
  technician: mark("a person who knows the machines"),
};

/** Return the address of a page of the docs as the build writes it (web/docs_pages.js), or "" for what is none. */
export function addressOf(page) {
  return PAGE.test(page) ? `docs/${page.replace(/\.md(?=#|$)/, ".html")}` : "";
}

/** Return the page's own line, if it has one: it comes before all others. */
function ownLine({connected, robot, now}, texts) {
  if (!connected) {
    return {level: 2, text: texts("Not connected: nothing is known of the arm, and nothing can be sent to it. "
      + "Somebody at the cell must watch it.")};
  }
  if (robot === null) return {level: 1, text: texts("No robot has been heard yet.")};
  if (robot.view === null) return {level: 1, text: texts("Nothing has been heard of this robot's state yet.")};
  if (robot.view.online === false) {
    return {level: 2, text: texts("The program that reports the state (console_node) has ended. What the arm does is not known here.")};
  }
  const age = (kind) => now - robot.heard[kind];
  const seconds = (kind) => ({seconds: Math.floor(age(kind) / 1000)});
  if (robot.old) return {level: 2, text: texts("Old: nothing was heard for {seconds} s. What the arm does now is not known here.", seconds("view"))};
  if (robot.screen === null) return {level: 1, text: texts("The robot's state comes without sentences yet.")};
  return age("screen") > SCREEN_OLD_AFTER ? {level: 1, text: texts("These sentences are {seconds} s old.", seconds("screen"))} : null;
}

/** Whether an element begins and ends within its box. */
function isInside(element, box) {
  const [inner, outer] = [element, box].map((each) => each.getBoundingClientRect());
  return inner.top >= outer.top - 1 && inner.bottom <= outer.bottom + 1;
}

export function make(parent, store, connection, texts, {now, every} = browser) {
  // a box of one height: whatever is said, nothing below it moves
  const box = add(parent, "div", {className: "status-box"});
  const own = add(box, "p", {className: "status-own", hidden: true});
  const worst = add(box, "div", {className: "status-worst", role: "status"});
  const more = add(parent, "details", {className: "status-more"});
  const summary = add(more, "summary", {"aria-label": texts("All states")});
  add(summary, "span", {className: "status-more-long", text: texts("All states")});
  add(summary, "span", {className: "status-more-short", text: "\u22ef"});
  const list = add(more, "ul", {className: "status-list"});
  let shown = "";
  // whether the page's own line stands in the place of what is past; whether the sentence can be read whole
  let past = false;
  let whole = true;

  /** Write as large as fits. It measures, and so is called only where the words or the box have changed. */
  const fit = () => {
    let fits = false;
    for (const size of SIZES) {
      box.style?.setProperty?.("--said", size);
      fits = !(box.scrollHeight > box.clientHeight + 1);
      if (fits) break;
    }
    box.classList.toggle("is-cut", !fits);
    read();
  };
  /** Look whether the sentence is in its box: who is waited for, and what to do, may be scrolled to there. */
  const read = () => {
    const sentence = worst.querySelector(".status-sentence");
    whole = !box.classList.contains("is-cut") || (sentence !== null && isInside(sentence, box));
    tell();
  };
  /** Tell whether the sentence can be read: approving needs it. */
  const tell = () => {
    const robot = store.robot(store.selected);
    if (robot === null) return;
    const word = past ? "old" : whole ? "whole" : "cut";
    if (robot.said !== word) store.set("said", robot.name, word);
  };
  box.addEventListener("scroll", read);

  const put = (into, line) => {
    const topic = texts.word(TOPICS, line.topic);
    const words = add(into, "div");
    add(words, "p", {className: "status-topic", text: topic});
    add(words, "p", {className: "status-sentence", text: texts.reason(line.sentence)});
    if (line.waits_for) {
      const [what, who] = [texts.reason(line.waits_for), texts.word(WHO, line.who)];
      add(words, "p", {text: who ? texts("Waits for: {what} ({who})", {what, who}) : texts("Waits for: {what}", {what})});
    }
    if (line.todo) add(words, "p", {className: "status-todo", text: texts("To do: {what}", {what: texts.reason(line.todo)})});
    const address = addressOf(line.page);
    if (address) {
      add(into, "a", {text: texts("Read more"), href: address, target: "_blank", rel: "noopener",
        "aria-label": texts("Read more about: {topic}", {topic})});
    }
  };

  // a person is waited for: in a fault of link or comparison, or as a matter of course, as for a verdict
  const level = (line) => (line.level === 2 && FAULTS.includes(line.topic) ? "level-2 is-fault" : `level-${line.level ?? 0}`);
  const show = () => {
    const robot = store.robot(store.selected);
    const line = ownLine({connected: connection.state === "connected", robot, now: now()}, texts);
    own.hidden = line === null;
    if (line !== null) {
      own.className = `status-own ${line.level === 2 ? "is-fault" : "level-2"}`;
      setText(own, line.text);
    }
    parent.classList.toggle("is-past", line !== null);
    // why nothing can be read comes in the place of what is past
    const turned = past !== (line !== null);
    past = line !== null;
    worst.hidden = line !== null || (robot?.screen ?? []).length === 0;
    const lines = robot?.screen ?? [];
    // again and again the same: a screen reader speaks, and a focus is lost, only where something has changed
    const wanted = JSON.stringify([store.selected, lines]);
    if (wanted === shown) {
      if (turned) fit();
      else tell();
      return;
    }
    shown = wanted;
    clear(worst);
    clear(list);
    more.hidden = lines.length === 0;
    if (lines.length === 0) {
      fit();
      return;
    }
    worst.className = `status-worst ${level(lines[0])}`;
    put(worst, lines[0]);
    for (const each of lines) put(add(list, "li", {className: level(each)}), each);
    fit();
  };
  if (globalThis.ResizeObserver !== undefined) new ResizeObserver(fit).observe(box);
  for (const kind of ["screen", "old", "connection", "selected", "robots"]) store.on(kind, show);
  every(250, show);
  show();
}
