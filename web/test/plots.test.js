import assert from "node:assert/strict";
import {test} from "node:test";
import {csv, field} from "../src/plots/csv.js";
import {axis, decimals, firstValue, gapColumns, spans} from "../src/plots/curve.js";
import {History, WINDOW_S} from "../src/plots/history.js";
import {Marks, Ring} from "../src/plots/ring.js";
import {view} from "./support/fake.js";

const DEGREE = Math.PI / 180;

function synced(changes = {}) {
  return view({sync: {...view().sync, state: "IN_SYNC", ...changes.sync}, link: {...view().link, state: "ARMED", ...changes.link}});
}

function history() {
  return new History(["joint_a1", "joint_a2"], ["revolute", "prismatic"]);
}

test("a ring keeps the newest samples in their order, and takes no more memory", () => {
  const ring = new Ring(5, 2, 1);
  for (let time = 0; time < 1000; time += 1) ring.push(time, time + 0.5, [time, -time]);
  assert.equal(ring.size, 5);
  assert.deepEqual([0, 1, 2, 3, 4].map((number) => ring.time(number)), [995, 996, 997, 998, 999]);
  assert.equal(ring.value(4, 1), -999);
  assert.equal(ring.stamp(0), 995.5);
});

test("what comes in one slot is merged, and the peak stays", () => {
  const ring = new Ring(4, 2, 1);
  ring.push(0.1, 0, [0.1, NaN]);
  ring.push(0.5, 0, [-3, 2]);
  ring.push(0.9, 0, [1, NaN]);
  assert.equal(ring.size, 1);
  assert.equal(ring.value(0, 0), -3);
  assert.equal(ring.value(0, 1), 2);
  assert.equal(ring.time(0), 0.9);
});

test("a time before the newest one is refused", () => {
  const ring = new Ring(4, 1, 1);
  assert.equal(ring.push(5, 0, [1]), true);
  assert.equal(ring.push(3, 0, [2]), false);
  assert.equal(ring.push(NaN, 0, [2]), false);
  assert.equal(ring.size, 1);
});

test("the first sample since a time is found, also where the ring has gone round", () => {
  const ring = new Ring(7, 1, 1);
  for (let time = 0; time < 20; time += 2) ring.push(time, 0, [time]);
  for (const time of [-1, 6, 7, 11.5, 18]) {
    const number = ring.firstSince(time);
    assert.ok(number === 0 || ring.time(number - 1) < time, `${time}`);
    assert.ok(ring.time(number) >= time, `${time}`);
  }
  assert.equal(ring.firstSince(19), ring.size);
});

test("marks use their places again", () => {
  const marks = new Marks(3);
  const places = new Set();
  for (let time = 0; time < 10; time += 1) {
    marks.push(time, "sync", `${time}`);
    for (let number = 0; number < marks.size; number += 1) places.add(marks.at(number));
  }
  assert.equal(places.size, 3);
  assert.deepEqual([0, 1, 2].map((number) => marks.at(number).text), ["7", "8", "9"]);
});

test("ten minutes of 25 views a second fit, and the eleventh minute pushes the first one out", () => {
  const one = history();
  for (let number = 0; number < 11 * 60 * 25; number += 1) one.take(100 + number * 0.04 + 0.001, {...synced(), stamp: number});
  const newest = one.ring.time(one.ring.size - 1);
  assert.ok(newest - one.ring.time(0) > WINDOW_S - 1);
  assert.equal(one.ring.capacity, 15000);
});

test("errors are kept in degrees and millimetres, and what is not known is no number", () => {
  const one = history();
  one.take(1, synced({sync: {error: [2 * DEGREE, 0.003]}, link: {round_trip_ms: 21.5, late: 4}}));
  one.take(2, view({sync: null, link: null}));
  one.take(3, synced({sync: {error: [null, 0.001]}, link: {round_trip_ms: null, late: null}}));
  assert.ok(Math.abs(one.ring.value(0, 0) - 2) < 1e-6);
  assert.ok(Math.abs(one.ring.value(0, 1) - 3) < 1e-6);
  assert.equal(one.ring.value(0, one.roundTrip), 21.5);
  assert.equal(one.ring.value(0, one.late), 4);
  for (const column of [0, 1, 2, 3]) assert.ok(Number.isNaN(one.ring.value(1, column)));
  assert.ok(Number.isNaN(one.ring.value(2, 0)));
});

test("late replies are counted on where the gateway was started again and counts from 0", () => {
  const one = history();
  [50, 52, 0, 3, null, 1].forEach((late, number) => one.take(1 + number, synced({link: {late}})));
  const values = Array.from({length: one.ring.size}, (_, number) => one.ring.value(number, one.late));
  assert.deepEqual(values, [50, 52, 52, 55, NaN, 56]);
});

test("a view of version 1, which tells no round trip, is drawn without", () => {
  const one = history();
  const old = synced();
  delete old.link.round_trip_ms;
  delete old.link.late;
  one.take(1, old);
  assert.ok(Number.isNaN(one.ring.value(0, one.roundTrip)));
});

test("each way in which something goes wrong leaves one mark", () => {
  const one = history();
  const kinds = () => Array.from({length: one.marks.size}, (_, number) => one.marks.at(number).kind);
  one.take(1, synced());
  one.take(2, synced({sync: {state: "HOLDING", reason: "a1 differs", violations: 1}}));
  one.take(3, synced({sync: {state: "HOLDING", reason: "a1 differs", violations: 1}}));
  assert.deepEqual(kinds(), ["sync"]);
  assert.equal(one.marks.at(0).text, "HOLDING: a1 differs");
  one.take(4, synced({sync: {violations: 1}}));
  // closed and open again between two views
  one.take(5, synced({sync: {violations: 2}}));
  one.take(6, synced({sync: {violations: 2}, link: {state: "NEEDS_RESET", reason: "stopped"}}));
  one.take(7, synced({sync: {violations: 2}, link: {state: "NEEDS_RESET", reason: "stopped"}}));
  assert.deepEqual(kinds(), ["sync", "sync", "link"]);
  const ended = view().execution;
  one.take(8, view({execution: {...ended, plan_id: "p", outcome: "stopped", reason: "by ada"}}));
  one.take(9, view({execution: {...ended, plan_id: "p", outcome: "stopped", reason: "by ada"}}));
  assert.deepEqual(kinds(), ["sync", "sync", "link", "execution"]);
  one.heard(10, false, "");
  one.heard(11, false, "");
  one.heard(12, true, "");
  assert.deepEqual(kinds().slice(4), ["page"]);
});

test("what was so when the page was opened is no fault of now", () => {
  const one = history();
  one.take(1, view({sync: {...view().sync, state: "STALE", violations: 7}, execution: {...view().execution, outcome: "stopped"}}));
  one.take(2, view({sync: {...view().sync, state: "STALE", violations: 7}, execution: {...view().execution, outcome: "stopped"}}));
  assert.equal(one.marks.size, 0);
});

test("a pixel column holds the smallest and the largest of its samples", () => {
  const ring = new Ring(100, 1, 0.1);
  for (let number = 0; number < 40; number += 1) ring.push(number * 0.1 + 0.01, 0, [number % 10]);
  const low = new Float32Array(4);
  const high = new Float32Array(4);
  assert.equal(spans(ring, 0, 0, 4, low, high), 9);
  assert.deepEqual([...low], [0, 0, 0, 0]);
  assert.deepEqual([...high], [9, 9, 9, 9]);
  assert.equal(spans(ring, 0, 3, 7, low, high), 9);
  assert.deepEqual([...low.slice(1)].map(Number.isNaN), [true, true, true]);
});

test("the counter of a window begins at its first known value", () => {
  const ring = new Ring(10, 1, 1);
  [NaN, 7, 8, 12].forEach((value, time) => ring.push(time, 0, [value]));
  assert.equal(firstValue(ring, 0, 0), 7);
  assert.equal(firstValue(ring, 0, 2), 8);
  assert.ok(Number.isNaN(firstValue(ring, 0, 9)));
});

test("an axis holds its largest value with one to six lines of a round step", () => {
  for (let power = -5; power <= 6; power += 0.037) {
    const largest = 10 ** power;
    const {step, top} = axis(largest, 1e-9);
    assert.ok(top >= largest * (1 - 1e-9), `${largest}`);
    assert.ok(top / step <= 6 + 1e-9 && top / step >= 1 - 1e-9, `${largest}: ${top / step}`);
    assert.ok(top <= 2.5 * largest, `${largest}: ${top}`);
    const digit = Number((step / 10 ** Math.floor(Math.log10(step) + 1e-9)).toFixed(6));
    assert.ok([1, 2, 5].includes(digit), `${step}`);
    assert.ok(Math.abs(Number(step.toFixed(decimals(step))) - step) < 1e-9 * step, `${step}`);
  }
  assert.ok(axis(0, 0.1).top >= 0.1);
});

test("a gap of some seconds breaks the line, whatever the width is", () => {
  assert.equal(gapColumns(2, 600, 600), 2);
  assert.equal(gapColumns(2, 60, 600), 1);
});

test("the CSV file has a row per sample and per fault, in their order", () => {
  const one = history();
  one.take(10, {...synced({sync: {error: [DEGREE, 0.002]}, link: {round_trip_ms: 20, late: 1}}), stamp: 1000.25});
  one.take(11, synced({sync: {state: "FAULT", reason: 'say "no", twice', error: [0, 0]}}));
  const rows = csv(one, 9).split("\r\n");
  assert.equal(rows[0], "seconds,stamp_s,error_joint_a1_deg,error_joint_a2_mm,round_trip_ms,late_replies,fault,fault_text");
  assert.equal(rows[1], "1,1000.25,1,2,20,1,,");
  assert.equal(rows[2], '2,,,,,,sync,"FAULT: say ""no"", twice"');
  assert.equal(rows[4], "");
  const columns = (row) => row.replace(/"([^"]|"")*"/g, "x").split(",").length;
  for (const row of rows.slice(0, 4)) assert.equal(columns(row), 8, row);
});

test("no text of the file is taken for a formula", () => {
  assert.equal(field("=HYPERLINK(1)"), "'=HYPERLINK(1)");
  assert.equal(field("@a,b"), '"\'@a,b"');
  assert.equal(field("plain"), "plain");
});
