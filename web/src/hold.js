/**
 * A button that is held to confirm: what it does starts something, or lifts what stops it. A touch alone does nothing.
 *
 * A page that stands still sees no release: a press in which it did, or in which `key()` has changed (what the person
 * was looking at), counts for nothing.
 */
import {add, setText} from "./dom.js";
import {onHold} from "./press.js";

/** A press must last so long [ms]. */
export const HELD_FOR = 1000;
/** Two looks of one press must not be further apart [ms]. */
const LONGEST_GAP = 400;
const LOOK_EVERY = 50;

/** The presses that are looked at, by clock: one timer for all buttons, which come and go. */
const looks = new WeakMap();

function pressesOf(clock, document) {
  if (!looks.has(clock)) {
    const pressing = new Map();
    looks.set(clock, pressing);
    clock.every(LOOK_EVERY, () => {
      for (const {look} of [...pressing.values()]) look();
    });
    document.addEventListener("visibilitychange", () => {
      for (const {release} of [...pressing.values()]) release();
    });
  }
  return looks.get(clock);
}

/**
 * Make the button.
 *
 * @param {() => string} [options.key] what must not change meanwhile
 * @returns {Element} with `say(text)`
 */
export function holdButton(parent, {text, className = "", onHeld, key = () => ""}, clock) {
  const {now} = clock;
  const pressing = pressesOf(clock, parent.ownerDocument);
  const element = add(parent, "button", {type: "button", className: `hold ${className}`});
  add(element, "span", {className: "hold-fill", "aria-hidden": "true"});
  const words = add(element, "span", {className: "hold-text", text});
  let began = null;
  let looked = 0;
  let seen = "";

  const draw = () => {
    element.classList.toggle("is-pressing", began !== null);
    element.style?.setProperty?.("--held", began === null ? "0" : Math.min(1, (now() - began) / HELD_FOR).toFixed(3));
  };
  const press = () => {
    if (element.disabled || began !== null) return;
    began = looked = now();
    seen = key();
    pressing.set(element, {look, release});
    draw();
  };
  const release = () => {
    began = null;
    pressing.delete(element);
    draw();
  };
  const look = () => {
    const at = now();
    if (at - looked > LONGEST_GAP || element.disabled || !element.isConnected || key() !== seen) {
      release();
      return;
    }
    looked = at;
    if (at - began < HELD_FOR) {
      draw();
      return;
    }
    release();
    onHeld();
  };
  onHold(element, press, release);
  element.say = (said) => setText(words, said);
  return element;
}
