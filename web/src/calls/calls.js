/**
 * Calls a person to the page while it runs: sound, vibration, title, badge and icon, and the screen stays on while a
 * plan waits. For what, and when it rings, is state.js. It calls for every robot, whichever is selected. A device that
 * is locked or asleep runs no page, and is not called.
 */
import {add, button, setText} from "../dom.js";
import {browser} from "../panels/clock.js";
import {remember, remembered, storageOf} from "../storage.js";
import {mark} from "../texts.js";
import {BEATS, makeSound} from "./sound.js";
import * as state from "./state.js";

/** How often it is looked what is due [ms]. */
const EVERY = 250;
const ICONS = {quiet: "icon.svg", calling: "icon_call.svg"};
/** Whether this device rings is kept in this browser. */
const KEY = "construction_twin.calls";
const OFF = "off";
const WORDS = {hold: mark("Arm holds"), question: mark("Question"), plan: mark("Plan waits"), message: mark("Message")};

/**
 * Keep the screen on while it is wanted, where the browser can (over HTTPS only); it takes that back whenever the page is hidden.
 *
 * @param {object} [wakeLock] as `navigator.wakeLock`
 * @returns {(wanted: boolean) => Promise<void>} asks or gives up as is wanted now; call it again when the page is in front again
 */
export function makeAwake(wakeLock, isVisible) {
  let lock = null;
  let last = Promise.resolve();
  return (wanted) => {
    // one after the other: a lock that comes late is given up too. A refused one (an empty battery) is asked for the next time
    last = last.then(async () => {
      if (!wanted) await lock?.release();
      const isHeld = lock !== null && !lock.released;
      lock = !wanted ? null : isHeld || !isVisible() ? lock : await wakeLock?.request("screen") ?? null;
    }).catch(() => {});
    return last;
  };
}

/**
 * Make the button that turns calls on and off, and begin to call.
 *
 * @param {object} [means] for tests: `now`, `every`, `Audio`, `navigator`, `storage`
 */
export function make(parent, store, connection, texts, means = {}) {
  const {
    now = browser.now, every = browser.every, Audio = globalThis.AudioContext, navigator = globalThis.navigator, storage = storageOf(),
  } = means;
  const document = parent.ownerDocument;
  const isVisible = () => document.visibilityState !== "hidden";
  let isOn = remembered(KEY, storage) !== OFF;
  let calls = state.begin();
  let shown = "";
  let wantsScreen = false;

  const sound = makeSound(Audio, () => show());
  const awake = makeAwake(navigator.wakeLock, isVisible);
  const line = add(parent, "span", {className: "calls-line", role: "status"});
  // before the account, so that nothing that can be pressed moves when it goes
  parent.querySelector(".account")?.before(line);
  const toggle = button(parent, "", onToggle, {className: "calls-open"});
  add(toggle, "span", {className: "calls-bell", "aria-hidden": "true"});
  const toggleText = add(toggle, "span");

  function onToggle() {
    isOn = !isOn;
    remember(KEY, isOn ? "on" : OFF, storage);
    // who turns it on hears what it sounds like; the press is the touch that a browser wants, and its answer takes a moment
    if (isOn) sound.unlock().then(() => ring("plan"));
    both();
  }

  function ring(kind) {
    sound.play(kind);
    if (navigator.userActivation?.hasBeenActive !== false) navigator.vibrate?.(BEATS[kind]);
  }

  /** Show what is so; nothing is changed that is so already. */
  function show() {
    const there = state.present(calls);
    const count = there.length;
    const locked = isOn && sound.state === "locked";
    const key = JSON.stringify([count, there[0]?.kind, connection.state, isOn, locked]);
    if (key === shown) return;
    shown = key;
    const title = texts("construction_twin console");
    document.title = connection.state === "lost" ? texts("Not connected - {title}", {title})
      : count ? `(${count}) ${texts(WORDS[there[0].kind])} - ${title}` : title;
    // it may be refused; then there is none
    (count ? navigator.setAppBadge?.(count) : navigator.clearAppBadge?.())?.catch(() => {});
    // of two files, because a picture made here would be another source than this server
    document.querySelector('link[rel="icon"]')?.setAttribute("href", count ? ICONS.calling : ICONS.quiet);
    setText(line, locked ? texts("No sound yet: touch the page once") : "");
    setText(toggleText, isOn ? texts("Calls on") : texts("Calls off"));
    toggle.classList.toggle("is-off", !isOn);
    toggle.classList.toggle("is-calling", count > 0);
  }

  /** Look at what waits, and call. */
  function both() {
    calls = state.renewed(calls, store.robots.map((name) => store.robot(name)), now());
    const {state: after, kind} = state.rung(calls, now());
    calls = after;
    if (kind !== "" && isOn) ring(kind);
    const wants = isOn && state.present(calls).some((call) => call.kind === "plan");
    if (wants !== wantsScreen) awake(wants);
    wantsScreen = wants;
    show();
  }

  const look = () => {
    calls = state.looked(calls);
  };
  for (const event of ["pointerdown", "keydown"]) {
    document.addEventListener(event, () => {
      if (isOn) sound.unlock();
      look();
    }, {capture: true, passive: true});
  }
  document.addEventListener("visibilitychange", () => {
    if (!isVisible()) return;
    look();
    awake(wantsScreen);
    both();
  });
  document.defaultView?.addEventListener("focus", look);
  store.on("acted", (robot, {topic}) => {
    calls = state.acted(calls, robot, topic, now());
  });
  // at once: timers of a page in the background run once a minute
  for (const kind of ["plan", "screen", "tasks", "messages", "connection", "old"]) store.on(kind, both);
  every(EVERY, both);
  // a browser may let a page that is installed sound without a touch
  if (isOn) sound.open();
  both();
}
