// The newest samples of some numbers, in memory that is taken once: a page that is open for days grows by nothing.
//
// Time is cut into slots of equal length, and a slot holds one sample. What else comes in the same slot is merged: of each number
// the value farther from zero stays, so that no peak is lost. NaN is a number that is not known. Times are seconds of a steady clock.

export class Ring {
  // capacity: slots that are kept; columns: numbers of a sample; slot: length of a slot [s]
  constructor(capacity, columns, slot) {
    this.capacity = capacity;
    this.columns = columns;
    this.slot = slot;
    this.size = 0;
    this._next = 0;
    this._lastSlot = -Infinity;
    this._times = new Float64Array(capacity);
    this._stamps = new Float64Array(capacity);
    this._values = new Float32Array(capacity * columns);
  }

  // Take a sample: `time` on this page's clock, `stamp` on the sender's, `row` with a number for each column.
  // A time before the newest one is refused: returns false.
  push(time, stamp, row) {
    const slot = Math.floor(time / this.slot);
    if (!(slot >= this._lastSlot)) return false;
    if (slot === this._lastSlot) {
      this._merge((this._next + this.capacity - 1) % this.capacity, time, stamp, row);
      return true;
    }
    this._lastSlot = slot;
    const at = this._next;
    this._times[at] = time;
    this._stamps[at] = stamp;
    for (let column = 0; column < this.columns; column += 1) this._values[at * this.columns + column] = row[column];
    this._next = (at + 1) % this.capacity;
    if (this.size < this.capacity) this.size += 1;
    return true;
  }

  _merge(at, time, stamp, row) {
    this._times[at] = time;
    this._stamps[at] = stamp;
    for (let column = 0; column < this.columns; column += 1) {
      const index = at * this.columns + column;
      const old = this._values[index];
      if (Number.isNaN(old) || Math.abs(row[column]) > Math.abs(old)) this._values[index] = row[column];
    }
  }

  // The samples are numbered from 0, the oldest one that is kept.
  time(number) {
    return this._times[this._place(number)];
  }

  stamp(number) {
    return this._stamps[this._place(number)];
  }

  value(number, column) {
    return this._values[this._place(number) * this.columns + column];
  }

  // Number of the first sample at or after `time`; `size` when there is none.
  firstSince(time) {
    let low = 0;
    let high = this.size;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.time(middle) < time) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  _place(number) {
    return (this._next - this.size + number + this.capacity) % this.capacity;
  }
}

// What happened at a moment, such as a fault: the newest `capacity` of them, in places that are used again.
export class Marks {
  constructor(capacity) {
    this.capacity = capacity;
    this.size = 0;
    this._next = 0;
    this._places = Array.from({length: capacity}, () => ({time: 0, kind: "", text: ""}));
  }

  push(time, kind, text) {
    const place = this._places[this._next];
    place.time = time;
    place.kind = kind;
    place.text = text;
    this._next = (this._next + 1) % this.capacity;
    if (this.size < this.capacity) this.size += 1;
  }

  // From 0, the oldest one that is kept. The object is used again: read it, and keep nothing of it.
  at(number) {
    return this._places[(this._next - this.size + number + this.capacity) % this.capacity];
  }
}
