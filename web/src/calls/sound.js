/**
 * The sounds of the calls, made of sine tones: nothing is loaded. A browser lets a page sound once a person has touched it.
 */

/** By kind: tones of [pitch [Hz], begin [s], length [s]]. They differ in number and direction, so that they are told apart from afar. */
export const TONES = {
  // down, twice
  hold: [[587, 0, 0.22], [440, 0.24, 0.34], [587, 0.8, 0.22], [440, 1.04, 0.34]],
  // three, upwards
  question: [[523, 0, 0.16], [659, 0.18, 0.16], [784, 0.36, 0.36]],
  // two, upwards
  plan: [[523, 0, 0.2], [784, 0.24, 0.4]],
  // one
  message: [[659, 0, 0.4]],
};
/** What a device that vibrates does [ms]: on, off, on. */
export const BEATS = {hold: [400, 150, 400], question: [120, 80, 120, 80, 120], plan: [200, 120, 200], message: [150]};
/** Amplitude of a tone: far from what a small loudspeaker distorts. */
const LOUD = 0.3;
const ATTACK = 0.02;

/**
 * Make the sound.
 *
 * @param {Function} [Context] as `AudioContext`; undefined: this browser has none
 * @param {() => void} onChange it was unlocked, or locked again
 */
export function makeSound(Context, onChange) {
  let context = null;
  /** Make it when it is first needed: a context of its own costs a device power. */
  function open() {
    if (context !== null || Context === undefined) return;
    context = new Context();
    context.addEventListener?.("statechange", onChange);
  }

  return {
    /** `none`: this browser makes no sound; `locked`: not before a person touches the page; `ready`. */
    get state() {
      if (Context === undefined) return "none";
      return context?.state === "running" ? "ready" : "locked";
    },

    open,

    /** A person has touched the page: from now on it may sound. */
    async unlock() {
      open();
      // a browser that refuses stays silent
      if (context !== null && context.state !== "running") await context.resume().catch(() => {});
      onChange();
    },

    /** Play a kind, where it can be heard. */
    play(kind) {
      if (context?.state !== "running") return;
      for (const [pitch, begin, length] of TONES[kind]) {
        const at = context.currentTime + 0.05 + begin;
        const tone = context.createOscillator();
        const level = context.createGain();
        tone.frequency.value = pitch;
        level.gain.setValueAtTime(0, at);
        level.gain.linearRampToValueAtTime(LOUD, at + ATTACK);
        level.gain.exponentialRampToValueAtTime(LOUD / 100, at + length);
        level.gain.linearRampToValueAtTime(0, at + length + ATTACK);
        tone.connect(level).connect(context.destination);
        tone.start(at);
        tone.stop(at + length + 2 * ATTACK);
      }
    },
  };
}
