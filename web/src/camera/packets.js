/**
 * What the console sends of a camera (console/camera_delivery.py): heads and pictures, and how old the newest picture is. Pure; times are
 * milliseconds of this browser's monotonic clock.
 */

const HEAD = 13;
/** Longest picture that is taken [bytes]; the console takes no longer one from a camera. */
const LARGEST = 2 * 2 ** 20;
/** A picture is shown as old after so long, and no more after so long [ms]. */
export const OLD_AFTER = 2000;
export const GONE_AFTER = 8000;

/** Cuts bytes into packets {jpeg, age, sent, there}; `jpeg` is null where there is no other picture. Throws RangeError at one too long. */
export class CameraPackets {
  constructor() {
    this._rest = new Uint8Array(0);
  }

  feed(bytes) {
    const all = new Uint8Array(this._rest.length + bytes.length);
    all.set(this._rest);
    all.set(bytes, this._rest.length);
    const packets = [];
    let at = 0;
    while (all.length - at >= HEAD) {
      const head = new DataView(all.buffer, at, HEAD);
      const length = head.getUint32(0);
      if (length > LARGEST) throw new RangeError(`a picture of ${length} bytes`);
      if (all.length - at - HEAD < length) break;
      packets.push({
        jpeg: length ? all.slice(at + HEAD, at + HEAD + length) : null, age: head.getUint32(4), sent: head.getUint32(8), there: head.getUint8(12) === 1,
      });
      at += HEAD + length;
    }
    this._rest = all.slice(at);
    return packets;
  }
}

/**
 * How old a camera's picture is. What a packet needs for its way beyond the shortest of the stream counts as age, too: on a slow network
 * pictures wait in buffers.
 */
export class PictureAge {
  constructor() {
    this._shortest = Infinity;
    this._taken = null;
  }

  /** Take a packet that came at a time. */
  take({jpeg, age, sent}, at) {
    this._shortest = Math.min(this._shortest, at - sent);
    if (jpeg !== null) this._taken = at - (age + (at - sent - this._shortest));
  }

  /** Return the age of the newest picture at a time; null: there is none. */
  at(now) {
    return this._taken === null ? null : Math.max(0, now - this._taken);
  }
}
