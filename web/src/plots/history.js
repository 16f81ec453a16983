// What the `view` of one robot said in the last ten minutes: joint errors, round trip, late replies, and faults as marks.
// Pure: times are arguments. Errors are stored in degrees or millimetres, as they are shown.

import {Marks, Ring} from "./ring.js";

export const WINDOW_S = 600;
// One sample for each of the 25 messages of a second.
const SLOT_S = 0.04;
const MOST_MARKS = 200;
const DEGREES = 180 / Math.PI;
const MILLIMETRES = 1000;
// States of the gate in which something is wrong, and of the link in which commands may go.
const CLOSED = new Set(["HOLDING", "REPLANNING", "STALE", "STOPPED", "FAULT"]);
const ENDED = new Set(["stopped", "held", "dropped"]);
const LINKED = "ARMED";

export class History {
  // names, types: of the joints, base to tip, as in `view`
  constructor(names, types) {
    this.names = [...names];
    this.types = [...types];
    this.roundTrip = names.length;
    this.late = names.length + 1;
    this.ring = new Ring(Math.ceil(WINDOW_S / SLOT_S), names.length + 2, SLOT_S);
    this.marks = new Marks(MOST_MARKS);
    this._row = new Float64Array(names.length + 2);
    this._scales = types.map((type) => (type === "prismatic" ? MILLIMETRES : DEGREES));
    this._sync = null;
    this._violations = null;
    this._link = null;
    this._outcome = null;
    this._plan = null;
    this._heard = true;
    this._late = null;
    this._lateBefore = 0;
  }

  // Whether a view is of the joints for which this was made.
  fits(view) {
    const names = view.joints.names;
    return names.length === this.names.length && names.every((name, number) => name === this.names[number]);
  }

  // The scale by which a joint's SI value is shown, and its unit.
  unit(joint) {
    return this.types[joint] === "prismatic" ? "mm" : "°";
  }

  shown(joint, value) {
    return value * this._scales[joint];
  }

  // Take a view that came at `time` [s].
  take(time, view) {
    this._watch(time, view);
    if (!view.online) return;
    const errors = view.sync ? view.sync.error : null;
    for (let joint = 0; joint < this.names.length; joint += 1) {
      const error = errors ? errors[joint] : null;
      this._row[joint] = isNumber(error) ? error * this._scales[joint] : NaN;
    }
    const link = view.link;
    this._row[this.roundTrip] = link && isNumber(link.round_trip_ms) ? link.round_trip_ms : NaN;
    this._row[this.late] = link && isNumber(link.late) ? this._counted(link.late) : NaN;
    this.ring.push(time, view.stamp, this._row);
  }

  // Return a counter of late replies that never falls: the gateway counts from 0 when it is started again.
  _counted(late) {
    if (this._late !== null && late < this._late) this._lateBefore += this._late;
    this._late = late;
    return this._lateBefore + late;
  }

  // Note that this page heard nothing any more, or hears again.
  heard(time, heard, text) {
    if (!heard && this._heard) this.marks.push(time, "page", text);
    this._heard = heard;
  }

  _watch(time, view) {
    const {sync, link, execution} = view;
    if (sync) {
      const entered = CLOSED.has(sync.state) && this._sync !== null && sync.state !== this._sync;
      // closed and open again between two views
      const missed = this._violations !== null && sync.violations > this._violations && !CLOSED.has(sync.state);
      if (entered || missed) this.marks.push(time, "sync", `${sync.state}: ${sync.reason}`);
      this._sync = sync.state;
      this._violations = sync.violations;
    }
    if (link) {
      if (this._link === LINKED && link.state !== LINKED) this.marks.push(time, "link", `${link.state}: ${link.reason}`);
      this._link = link.state;
    } else if (this._link !== null) {
      if (this._link === LINKED) this.marks.push(time, "link", "");
      this._link = null;
    }
    if (execution) {
      const ended = ENDED.has(execution.outcome) && this._outcome !== null;
      if (ended && (execution.outcome !== this._outcome || execution.plan_id !== this._plan)) {
        this.marks.push(time, "execution", `${execution.outcome}: ${execution.reason}`);
      }
      this._outcome = execution.outcome;
      this._plan = execution.plan_id;
    }
  }
}

function isNumber(value) {
  return typeof value === "number" && Number.isFinite(value);
}
