/**
 * Whether a person can see what the picture draws of a robot. A plan counts as played only where its motion could be
 * seen. Pure.
 *
 * Words: `seen`; why not: `model` (the robot's model is not there), `lost` (the browser has taken the graphics away),
 * `small` (the picture is smaller than `LEAST`), `away` (less than half of the picture is in view, the page is in the
 * background, or other robots are shown).
 */

/** This much of the picture must be in view: a fraction of its area. */
export const IN_VIEW = 0.5;

/** The least size of a robot's part of the picture in which a motion can be judged [px]. */
export const LEAST = {width: 300, height: 180};

/** Return the word for one robot; `size` of its part of the picture [px]. */
export function seenWord({lost, ready, shown, inView, visible, size = LEAST}) {
  if (lost) return "lost";
  if (!ready) return "model";
  if (shown && (size.width < LEAST.width || size.height < LEAST.height)) return "small";
  return shown && visible && inView >= IN_VIEW ? "seen" : "away";
}
