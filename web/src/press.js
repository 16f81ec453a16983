/** The gestures of a button that is held: a finger, a mouse or a key that goes down and up. What a hold does is its owner's. */

/**
 * Tell when a press of a button begins and ends.
 *
 * A press ends with the finger or key, when either leaves the button, and with Escape. That a hidden page ends it too is its owner's.
 *
 * @param {() => void} release also where nothing was pressed
 */
export function onHold(element, press, release) {
  element.addEventListener("pointerdown", (event) => {
    // a browser keeps a touch for what it began on, the words in the button maybe, and would not tell that the finger has left it
    if (event.target?.hasPointerCapture?.(event.pointerId)) event.target.releasePointerCapture(event.pointerId);
    if (event.button === 0 || event.button === undefined) press();
  });
  for (const kind of ["pointerup", "pointercancel", "pointerleave", "blur"]) element.addEventListener(kind, () => release());
  // a long press opens a menu on a tablet, which would take the finger away from the button
  element.addEventListener("contextmenu", (event) => event.preventDefault());
  element.addEventListener("keydown", (event) => {
    if (event.key === "Escape") release();
    if (event.key !== "Enter" && event.key !== " ") return;
    event.preventDefault();
    if (!event.repeat) press();
  });
  element.addEventListener("keyup", (event) => {
    if (event.key === "Enter" || event.key === " ") release();
  });
}
