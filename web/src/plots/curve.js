// From samples to what is drawn: of each pixel column the smallest and the largest value, in arrays that the caller prepares once.

// Fill `low` and `high`, one entry per pixel column of the time from `begin` to `end` [s]; NaN where there is no sample.
// Returns the largest value, 0 for none.
export function spans(ring, column, begin, end, low, high) {
  const width = low.length;
  low.fill(NaN);
  high.fill(NaN);
  const perSecond = width / (end - begin);
  let largest = 0;
  for (let number = ring.firstSince(begin); number < ring.size; number += 1) {
    const time = ring.time(number);
    if (time > end) break;
    const value = ring.value(number, column);
    if (Number.isNaN(value)) continue;
    const x = Math.min(width - 1, Math.floor((time - begin) * perSecond));
    if (!(low[x] <= value)) low[x] = value;
    if (!(high[x] >= value)) high[x] = value;
    if (value > largest) largest = value;
  }
  return largest;
}

// Return a counter's first known value since `begin`, which is where its curve starts; NaN when there is none.
export function firstValue(ring, column, begin) {
  for (let number = ring.firstSince(begin); number < ring.size; number += 1) {
    const value = ring.value(number, column);
    if (!Number.isNaN(value)) return value;
  }
  return NaN;
}

// Where a line is broken: at least so many empty columns of `seconds` each follow each other.
export function gapColumns(seconds, width, window) {
  return Math.max(1, Math.ceil((seconds * width) / window));
}

// The upper end of an axis that holds `largest`, and the step of its lines: 1, 2 or 5 times a power of ten, three to six lines.
export function axis(largest, smallest = 1e-3) {
  const top = Math.max(largest, smallest);
  const power = 10 ** Math.floor(Math.log10(top));
  for (const factor of [0.2, 0.5, 1, 2]) {
    const step = factor * power;
    const lines = Math.ceil(top / step - 1e-9);
    if (lines <= 6) return {step, top: Math.max(1, lines) * step};
  }
  return {step: 5 * power, top: 10 * power};
}

// Decimals with which the lines of an axis are written.
export function decimals(step) {
  return Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
}
