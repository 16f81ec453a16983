/** Whether a device draws shadows: it does until frames take too long, and does not begin again. Pure; milliseconds. */

/** So many frames are looked at; half of them may hold the page up for so long, or come so late after the one before. */
const FRAMES = 20;
const HELD = 14;
const LATE = 60;

/**
 * Make the judge of a device.
 *
 * @returns {(held: number, gap: number) => boolean} takes of a frame how long it held the page up, and how long after the one before
 *   it came, 0 where nothing was to be drawn in between; returns whether shadows may stay
 */
export function makePace() {
  let frames = [];
  let fast = true;
  return (held, gap) => {
    frames.push(held > HELD || gap > LATE);
    if (frames.length === FRAMES) {
      if (frames.filter(Boolean).length > FRAMES / 2) fast = false;
      frames = [];
    }
    return fast;
  };
}
