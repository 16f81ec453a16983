/** Keeps the screen on while it is wanted, where the browser can (over HTTPS only). It takes that back whenever the page is hidden. */

/**
 * @param {object} [wakeLock] as `navigator.wakeLock`; undefined: this browser cannot
 * @param {() => boolean} isVisible whether the page is in front
 */
export function makeAwake(wakeLock, isVisible) {
  let wanted = false;
  let held = null;
  let asking = false;

  async function ask() {
    if (!wanted || held !== null || asking || wakeLock === undefined || !isVisible()) return;
    asking = true;
    try {
      const lock = await wakeLock.request("screen");
      held = lock;
      lock.addEventListener("release", () => {
        if (held === lock) held = null;
      });
    } catch {
      // an empty battery, or hidden meanwhile: it is asked for again when the page is in front again
    } finally {
      asking = false;
    }
    if (!wanted) drop();
  }

  function drop() {
    const lock = held;
    held = null;
    lock?.release().catch(() => {});
  }

  return {
    get can() {
      return wakeLock !== undefined;
    },

    get held() {
      return held !== null;
    },

    /** Say whether it is wanted now. */
    want(now) {
      if (wanted === now) return;
      wanted = now;
      if (wanted) ask();
      else drop();
    },

    /** The page has come to the front again. */
    shown: ask,
  };
}
