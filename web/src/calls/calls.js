/**
 * Calls a person to the page while it runs: sound, vibration, title, badge and icon, and the screen stays on while a plan waits. For what,
 * and when it rings, is state.js. It calls for every robot, whichever is selected. A device that is locked or asleep runs no page, and
 * is not called: nothing here can change that, and the settings say so.
 */
import {add, button, setText} from "../dom.js";
import {browser} from "../panels/clock.js";
import {ownStorage} from "../planning/poses.js";
import {makeAwake} from "./awake.js";
import {load, save} from "./settings.js";
import {BEATS, makeSound} from "./sound.js";
import * as state from "./state.js";

/** How often it is looked what is due [ms]. */
const EVERY = 250;
/** The line about the sound goes after so long [ms]: a finger that is lifted must find what it has touched where it was. */
const LINE_STAYS = 1200;
const ICONS = {quiet: "icon.svg", calling: "icon_call.svg"};

/**
 * Make the button with its settings, and begin to call.
 *
 * @param {Element} parent the page's header
 * @param {object} store see store.js
 * @param {object} connection see connection.js
 * @param {Function} texts see texts.js
 * @param {object} [means] for tests: `now`, `every`, `Audio`, `navigator`, `storage`
 */
export function make(parent, store, connection, texts, means = {}) {
  const {
    now = browser.now, every = browser.every, Audio = globalThis.AudioContext, navigator = globalThis.navigator, storage = ownStorage(),
  } = means;
  const document = parent.ownerDocument;
  const isVisible = () => document.visibilityState !== "hidden";
  let settings = load(storage);
  let calls = state.begin();
  let shownTitle = "";
  let shownCount = 0;
  let wasReady = false;
  let unlockedAt = -Infinity;

  const sound = makeSound(Audio, () => show());
  const awake = makeAwake(navigator.wakeLock, isVisible);

  // -- what a person sees and presses

  const line = add(parent, "span", {className: "calls-line", role: "status"});
  // before the account, so that nothing that can be pressed moves when it goes
  parent.querySelector(".account")?.before(line);
  const opener = button(parent, "", () => open(panel.hidden), {className: "calls-open", "aria-expanded": "false", "aria-controls": "calls-panel"});
  add(opener, "span", {className: "calls-bell", "aria-hidden": "true"});
  const openerText = add(opener, "span");
  const panel = add(parent, "section", {id: "calls-panel", className: "calls-panel", "aria-labelledby": "calls-title", hidden: true});
  parent.after(panel);
  add(panel, "h2", {id: "calls-title", text: texts("calls.title")});
  const choices = add(panel, "div");
  const onBox = checkbox("on", () => change({on: onBox.checked}));
  const awakeBox = checkbox("awake", () => change({awake: awakeBox.checked}));
  const sounds = add(panel, "div");
  const volumeLabel = add(sounds, "label", {className: "calls-volume"});
  add(volumeLabel, "span", {text: texts("calls.volume")});
  const volume = add(volumeLabel, "input", {type: "range", min: "0", max: "100", step: "5"});
  const volumeText = add(volumeLabel, "span", {className: "calls-percent"});
  const tests = add(sounds, "div", {className: "calls-tests", role: "group", "aria-labelledby": "calls-test"});
  add(tests, "span", {id: "calls-test", text: texts("calls.test")});
  for (const kind of state.KINDS) button(tests, texts(`calls.word.${kind}`), () => onTest(kind));
  const heard = add(sounds, "p", {className: "calls-note", role: "status"});
  const notes = add(panel, "div", {className: "calls-notes"});
  const notKept = add(notes, "p", {className: "calls-note", text: texts("calls.not_kept"), hidden: true});
  add(notes, "p", {className: "calls-note", text: texts("calls.limits")});
  button(notes, texts("calls.close"), () => open(false), {className: "calls-close"});

  function checkbox(name, onChange) {
    const label = add(choices, "label", {className: "calls-check"});
    const box = add(label, "input", {type: "checkbox", on: {change: onChange}});
    add(label, "span", {text: texts(`calls.${name}`)});
    return box;
  }

  function open(wanted) {
    if (panel.hidden !== wanted) return;
    panel.hidden = !wanted;
    opener.setAttribute("aria-expanded", String(wanted));
    setText(heard, "");
    if (!wanted && panel.contains(document.activeElement)) opener.focus();
  }

  function change(changed) {
    settings = {...settings, ...changed};
    notKept.hidden = save(storage, settings);
    act();
    show();
  }

  function onTest(kind) {
    // pressing it is the touch that a browser wants, and its answer takes a moment
    sound.unlock();
    const ring = () => {
      const isHeard = sound.play(kind, settings.volume);
      const vibrates = vibrate(kind);
      const silent = settings.volume === 0 ? "zero" : sound.state === "none" ? "none" : "blocked";
      setText(heard, texts(isHeard ? "calls.sounds" : vibrates ? "calls.vibrates" : `calls.silent.${silent}`));
    };
    if (sound.state === "ready") ring();
    else setTimeout(ring, EVERY);
  }

  volume.addEventListener("input", () => change({volume: Number(volume.value) / 100}));

  function vibrate(kind) {
    if (typeof navigator.vibrate !== "function" || navigator.userActivation?.hasBeenActive === false) return false;
    return navigator.vibrate(BEATS[kind]);
  }

  /** The icon in the tab; of two files, because a picture made here would be another source than this server. */
  function setIcon(name) {
    const link = document.querySelector('link[rel="icon"]');
    if (link !== null && link.getAttribute("href") !== name) link.setAttribute("href", name);
  }

  function setBadge(count) {
    const done = count === 0 ? navigator.clearAppBadge?.() : navigator.setAppBadge?.(count);
    // it may be refused; then there is none
    done?.catch(() => {});
  }

  /** Show what is so; nothing is changed that is so already. */
  function show() {
    const there = state.present(calls);
    const title = texts("page.title");
    const offline = connection.state === "lost";
    const wanted = offline ? texts("calls.offline", {title})
      : there.length ? texts("calls.waits", {count: there.length, what: texts(`calls.word.${there[0].kind}`), title}) : title;
    if (wanted !== shownTitle) document.title = wanted;
    shownTitle = wanted;
    if (there.length !== shownCount) {
      setBadge(there.length);
      setIcon(there.length ? ICONS.calling : ICONS.quiet);
    }
    shownCount = there.length;
    const ready = sound.state === "ready";
    if (ready && !wasReady) unlockedAt = now();
    wasReady = ready;
    const locked = settings.on && settings.volume > 0 && sound.state === "locked";
    const wasLocked = settings.on && now() - unlockedAt < LINE_STAYS && line.textContent !== "";
    if (locked || !wasLocked) setText(line, locked ? texts("calls.locked") : "");
    line.classList.toggle("is-over", !locked);
    setText(openerText, texts(settings.on ? "calls.button_on" : "calls.button_off"));
    opener.classList.toggle("is-off", !settings.on);
    opener.classList.toggle("is-calling", there.length > 0);
    onBox.checked = settings.on;
    awakeBox.checked = settings.awake && awake.can;
    awakeBox.disabled = !awake.can;
    volume.disabled = !settings.on || sound.state === "none";
    const percent = Math.round(100 * settings.volume);
    if (Number(volume.value) !== percent) volume.value = String(percent);
    setText(volumeText, `${percent} %`);
  }

  // -- when

  /** Look at what waits, and call. */
  function act() {
    calls = state.renewed(calls, store.robots.map((name) => store.robot(name)), now());
    const {state: after, kind} = state.rung(calls, now());
    calls = after;
    if (kind !== "" && settings.on) {
      sound.play(kind, settings.volume);
      vibrate(kind);
    }
    awake.want(settings.awake && state.present(calls).some((call) => call.kind === "plan"));
  }

  const both = () => {
    act();
    show();
  };
  const onTouch = () => {
    if (settings.on) sound.unlock();
    calls = state.looked(calls);
  };
  for (const event of ["pointerdown", "keydown"]) document.addEventListener(event, onTouch, {capture: true, passive: true});
  document.addEventListener("visibilitychange", () => {
    if (!isVisible()) return;
    calls = state.looked(calls);
    awake.shown();
    both();
  });
  document.defaultView?.addEventListener("focus", () => {
    calls = state.looked(calls);
  });
  for (const each of [opener, panel]) {
    each.addEventListener("keydown", (event) => {
      if (event.key === "Escape") open(false);
    });
  }
  store.on("acted", (robot, {topic}) => {
    calls = state.acted(calls, robot, topic, now());
  });
  // at once: timers of a page in the background run once a minute
  for (const kind of ["plan", "screen", "tasks", "messages", "connection", "old"]) store.on(kind, both);
  every(EVERY, both);
  // a browser may let a page that is installed sound without a touch
  if (settings.on) sound.open();
  both();
}
