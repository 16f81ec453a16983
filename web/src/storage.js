/** What this browser keeps for the page. One may forbid it: then nothing is kept, and the page works without. */

/** Return one of the browser's storages, null where it is forbidden: then already the name throws. */
export function storageOf(name = "localStorage") {
  try {
    return globalThis[name];
  } catch {
    return null;
  }
}

/** Return what is kept under a key, null: nothing. */
export function remembered(key, storage = storageOf()) {
  try {
    return storage.getItem(key);
  } catch {
    return null;
  }
}

/** Keep a text under a key; return whether it outlasts a reload. */
export function remember(key, value, storage = storageOf()) {
  try {
    storage.setItem(key, value);
    return true;
  } catch {
    return false;
  }
}
