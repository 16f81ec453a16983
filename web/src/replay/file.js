/**
 * A recorded run, as evaluation/replay.py writes it: read, checked, and looked up by time. Pure but for `loadReplay`, which fetches.
 *
 * The file lies in a folder of results, where anybody who may write there can put one: whatever it holds is checked before anything
 * of it is shown, and it is never read beyond `LARGEST`. Times are seconds since the recording's first sample.
 */

/** Largest file that is read [bytes, not compressed]: evaluation/replay.py stays far below it. */
export const LARGEST = 8 * 2 ** 20;
const FORMAT = "construction_twin replay";
const VERSION = 1;
const MOST = {rows: 15000, joints: 32, marks: 500, text: 300, numbers: 200000};
/** This many of the file's integers are a radian or a metre. */
const POSITIONS = 1e5;
const ERRORS = 1e9;
const DEGREES = 180 / Math.PI;
/** What the report says of the whole run: numbers, or null for what is not known. */
const FIGURES = ["duration", "samples", "waypoints", "lag", "commands_lost", "late_replies", "round_trip_ms"];

/** Why a recording cannot be played: `key` and `values` of a sentence. */
export class ReplayError extends Error {
  constructor(key, values = {}) {
    super(key);
    this.key = key;
    this.values = values;
  }
}

const isText = (value, most = MOST.text) => typeof value === "string" && value.length <= most;
const isNumber = (value) => typeof value === "number" && Number.isFinite(value);
const isKnown = (value) => value === null || isNumber(value);
const isObject = (value) => typeof value === "object" && value !== null && !Array.isArray(value);

function expect(is, what) {
  if (!is) throw new ReplayError("replay.broken", {what});
}

/** Fetch a file of this server and read it; ReplayError says what is wrong with it. `get` is for tests. */
export async function loadReplay(href, get = (path) => fetch(path, {credentials: "same-origin"})) {
  let text;
  try {
    const answer = await get(href);
    if (answer.status === 403) throw new ReplayError("runs.forbidden");
    if (answer.status === 404) throw new ReplayError("replay.gone");
    if (!answer.ok) throw new ReplayError("replay.not_loaded", {why: answer.status});
    text = await limited(answer.body);
  } catch (error) {
    if (error instanceof ReplayError) throw error;
    throw new ReplayError("replay.not_loaded", {why: error.message});
  }
  return readReplay(text);
}

/** Return a stream's text; one that is too long is left off where it became so. */
async function limited(body) {
  const reader = body.getReader();
  const decoder = new TextDecoder();
  let text = "";
  let bytes = 0;
  for (;;) {
    const {done, value} = await reader.read();
    if (done) return text + decoder.decode();
    bytes += value.byteLength;
    if (bytes > LARGEST) {
      await reader.cancel();
      throw new ReplayError("replay.too_large", {most: LARGEST / 2 ** 20});
    }
    text += decoder.decode(value, {stream: true});
  }
}

/** Return the recording in a file's text; ReplayError for anything that is not one, whole. */
export function readReplay(text) {
  let document;
  try {
    document = JSON.parse(text);
  } catch {
    throw new ReplayError("replay.broken", {what: "JSON"});
  }
  expect(isObject(document) && document.format === FORMAT, "format");
  if (document.version !== VERSION) throw new ReplayError("replay.version", {version: String(document.version).slice(0, 20)});
  const {robot, joints, types, begin, period, marks, report} = document;
  expect(isText(robot) && robot !== "", "robot");
  expect(Array.isArray(joints) && joints.length > 0 && joints.length <= MOST.joints && joints.every((name) => isText(name, 100) && name !== "")
    && new Set(joints).size === joints.length, "joints");
  expect(Array.isArray(types) && types.length === joints.length && types.every((type) => type === "revolute" || type === "prismatic"), "types");
  expect(isNumber(begin) && Number.isFinite(new Date(begin * 1000).getTime()), "begin");
  expect(isNumber(period) && period > 0, "period");
  expect(Array.isArray(document.twin) && document.twin.length >= 2 && document.twin.length <= MOST.rows
    && document.twin.length * joints.length <= MOST.numbers, "twin");
  const rows = document.twin.length;
  const table = (name, scale, least) => {
    const found = document[name];
    expect(Array.isArray(found) && found.length === rows, name);
    const values = new Float64Array(rows * joints.length).fill(NaN);
    found.forEach((row, number) => {
      if (row === null) return;
      expect(Array.isArray(row) && row.length === joints.length, name);
      row.forEach((value, joint) => {
        expect(Number.isSafeInteger(value) && value >= least, name);
        values[number * joints.length + joint] = value / scale;
      });
    });
    return values;
  };
  expect(Array.isArray(marks) && marks.length <= MOST.marks, "marks");
  for (const mark of marks) {
    expect(isObject(mark) && isNumber(mark.time) && mark.time >= 0 && typeof mark.fault === "boolean"
      && ["source", "state", "reason", "by"].every((name) => isText(mark[name])), "marks");
  }
  expect(isObject(report) && Array.isArray(report.table) && report.table.length <= MOST.joints, "report");
  for (const row of report.table) {
    expect(isObject(row) && joints.includes(row.joint) && [row.average, row.largest].every(isNumber)
      && [row.paper_average, row.paper_largest].every(isKnown), "report");
  }
  expect(FIGURES.every((name) => isKnown(report[name])) && typeof report.mock === "boolean", "report");
  expect(isText(document.alignment, 40), "alignment");
  expect(Number.isSafeInteger(document.marks_left_out) && document.marks_left_out >= 0, "marks_left_out");
  return {
    robot, joints, types, period, marks, report, rows, begin: new Date(begin * 1000), duration: (rows - 1) * period,
    alignment: document.alignment, leftOut: document.marks_left_out,
    twin: table("twin", POSITIONS, -Infinity), arm: table("arm", POSITIONS, -Infinity), errors: table("errors", ERRORS, 0),
  };
}

/** Return a body's joint positions at a time, straight between two rows; null where the recording has none. */
export function poseAt(replay, body, time) {
  const {joints: {length}, rows, period} = replay;
  const values = replay[body];
  const place = Math.min(Math.max(time / period, 0), rows - 1);
  const row = Math.min(Math.floor(place), rows - 2);
  const begin = values.subarray(row * length, (row + 1) * length);
  const end = values.subarray((row + 1) * length, (row + 2) * length);
  const part = place - row;
  const from = part === 1 ? end : begin;
  if (Number.isNaN(from[0])) return null;
  if (Number.isNaN(begin[0]) || Number.isNaN(end[0])) return [...from];
  return Array.from(begin, (value, joint) => value + part * (end[joint] - value));
}

/** Return the joint whose error is the largest at a time, in ° or mm: {joint, value, unit}; null where none is known. */
export function errorAt(replay, time) {
  const row = Math.min(Math.max(Math.ceil(time / replay.period - 1e-6), 0), replay.rows - 1);
  return largestOf(replay, row);
}

function largestOf({joints, types, errors}, row) {
  let found = null;
  joints.forEach((joint, k) => {
    const shown = errors[row * joints.length + k] * (types[k] === "prismatic" ? 1000 : DEGREES);
    if (!Number.isNaN(shown) && !(found?.value >= shown)) found = {joint, value: shown, unit: types[k] === "prismatic" ? "mm" : "°"};
  });
  return found;
}

/**
 * Return the error as a curve: of each of `columns` of time the largest one of any joint, in ° and mm alike; NaN where none is known.
 */
export function curveOf(replay, columns) {
  const curve = new Float64Array(columns).fill(NaN);
  for (let row = 0; row < replay.rows; row += 1) {
    const value = largestOf(replay, row)?.value ?? NaN;
    const column = Math.min(columns - 1, Math.floor((row / (replay.rows - 1)) * columns));
    if (!Number.isNaN(value) && !(curve[column] >= value)) curve[column] = value;
  }
  return curve;
}

/** Return what a curve is as the path of an SVG, `width` wide and `height` high, with its largest value at the top; broken at gaps. */
export function pathOf(curve, height) {
  const top = curve.reduce((most, value) => (value > most ? value : most), 0) || 1;
  let open = false;
  return Array.from(curve, (value, x) => {
    if (Number.isNaN(value)) {
      open = false;
      return "";
    }
    const point = `${open ? "L" : "M"}${x} ${(height * (1 - value / top)).toFixed(2)}`;
    open = true;
    return point;
  }).join("");
}

/** Return the newest mark at a time, of one source or of all; null before the first. */
export function markAt({marks}, time, source = null) {
  let found = null;
  for (const mark of marks) if (mark.time <= time + 1e-9 && (source === null || mark.source === source)) found = mark;
  return found;
}
