/** Whether and how loud this device calls; kept in this browser, for nobody else. */

const KEY = "construction_twin.calls";
/** `on`: it rings and vibrates; `volume` 0 to 1; `awake`: the screen stays on while a plan waits. */
export const DEFAULT = {on: true, volume: 0.6, awake: true};

/** Return the settings of a stored text; what is missing, or not as expected, is as it is by default. */
export function read(text) {
  let stored = null;
  try {
    stored = JSON.parse(text);
  } catch {
    // of another version, or broken
  }
  const {on, volume, awake} = typeof stored === "object" && stored !== null ? stored : {};
  return {
    on: typeof on === "boolean" ? on : DEFAULT.on,
    volume: typeof volume === "number" && volume >= 0 && volume <= 1 ? volume : DEFAULT.volume,
    awake: typeof awake === "boolean" ? awake : DEFAULT.awake,
  };
}

/** Return the settings of this browser; storage null, or one that is forbidden: the default ones. */
export function load(storage) {
  try {
    return read(storage.getItem(KEY));
  } catch {
    return {...DEFAULT};
  }
}

/** Keep the settings; returns whether they outlast a reload. */
export function save(storage, settings) {
  try {
    storage.setItem(KEY, JSON.stringify(settings));
    return true;
  } catch {
    // a browser that keeps nothing for pages: they hold until it is reloaded
    return false;
  }
}
