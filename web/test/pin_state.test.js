import assert from "node:assert/strict";
import {readFileSync} from "node:fs";
import {test} from "node:test";
import {HIDDEN_FOR, begin, declined, entered, entitled, invited, isAway, isLocked, known, locked, paired, refusal, tokenOf, tried, typed} from "../src/pin_state.js";

const PINS = JSON.parse(readFileSync(new URL("../../test/data/pins.json", import.meta.url), "utf8"));
const TOKEN = "T".repeat(43);
const ADA = {account: "ada", device_account: "ada-device", number: 3, tries: 5};
const locked_ = known(begin(), ADA);
const open = tried(entered(locked_, "482139"), "");

test("a PIN that is guessed first is refused, as the console refuses it", () => {
  for (const [pin, why] of Object.entries(PINS)) assert.equal(refusal(pin), why, pin);
});

test("an invitation is the address's end and nothing else", () => {
  assert.equal(tokenOf(`#pair=${TOKEN}`), TOKEN);
  for (const hash of ["", "#", "#pair=", "#pair=short", `#pair=${TOKEN}x`, `#x&pair=${TOKEN}`, `#pair=${"<".repeat(43)}`]) assert.equal(tokenOf(hash), "");
});

test("digits are typed and taken back, twelve at most", () => {
  assert.equal([..."48213"].reduce(typed, ""), "48213");
  assert.equal(typed("482", "back"), "48");
  assert.equal(typed("", "back"), "");
  assert.equal(typed("482", "x"), "482");
  assert.equal(typed("4".repeat(12), "5").length, 12);
});

test("a paired device is locked until its PIN was right, and whoever is not paired is never", () => {
  assert.equal(isLocked(begin()), false);
  assert.equal(isLocked(locked_), true);
  const trying = entered(locked_, "482139");
  assert.deepEqual([trying.step, isLocked(trying)], ["trying", true]);
  assert.equal(isLocked(open), false);
  for (const why of ["wrong_pin", "pin_erased", "silent", "closed", "refused", "abandoned"]) assert.equal(isLocked(tried(trying, why)), true, why);
  assert.equal(tried(trying, "wrong_pin").told, "wrong_pin");
  assert.equal(tried(trying, "closed").told, "unreachable");
  // an answer to what was given up meanwhile opens nothing
  assert.equal(tried(locked(trying), "").step, "locked");
});

test("five digits are no try", () => {
  assert.deepEqual([entered(locked_, "48213").step, entered(locked_, "48213").told], ["locked", "short"]);
});

test("who is away for a minute by either clock has to give the PIN again", () => {
  const since = {wall: 1e6, steady: 5e3};
  assert.equal(isAway(null, 9e9, 9e9), false);
  assert.equal(isAway(since, 1e6 + HIDDEN_FOR - 1, 5e3 + HIDDEN_FOR - 1), false);
  assert.equal(isAway(since, 1e6 + HIDDEN_FOR, 5e3), true);
  assert.equal(isAway(since, 0, 5e3 + HIDDEN_FOR), true);
  assert.equal(locked(open).step, "locked");
  assert.equal(locked(entitled(locked_)).step, "locked");
  // nobody has a PIN for a device that is not paired
  assert.equal(locked(begin()).step, "password");
});

test("a PIN is chosen twice, then the device is paired and logs in", () => {
  let state = begin(TOKEN);
  assert.equal(state.step, "choose");
  assert.equal(known(state, {account: ""}).step, "choose");
  assert.equal(entered(state, "123456").told, "pin.row");
  state = entered(state, "482139");
  assert.equal(state.step, "again");
  const different = entered(state, "482138");
  assert.deepEqual([different.step, different.told, different.chosen], ["choose", "different", ""]);
  state = entered(state, "482139");
  assert.equal(state.step, "pairing");
  const done = paired(state, {ok: true, account: "ada", device_account: "ada-device", number: 3}, 5);
  assert.deepEqual([done.step, done.device, done.token, done.chosen], ["trying", ADA, "", ""]);
});

test("a pairing that fails leaves what there was", () => {
  const pairing = entered(entered(begin(TOKEN), "482139"), "482139");
  const no = (why, state = pairing) => paired(state, {ok: false, why}, 5);
  assert.deepEqual([no("code").step, no("code").told, no("code").token], ["password", "code", ""]);
  assert.deepEqual([no("console").step, no("console").told], ["password", "failed"]);
  // whether the console had it is not known: once more with the same code says so
  assert.deepEqual([no("unreachable").step, no("unreachable").token], ["choose", TOKEN]);
  assert.deepEqual([no("pin").step, no("pin").token], ["choose", TOKEN]);
  const before = entered(entered(invited(locked_, TOKEN), "482139"), "482139");
  assert.deepEqual([no("code", before).step, no("code", before).device], ["locked", ADA]);
  assert.equal(declined(invited(locked_, TOKEN)).step, "locked");
  assert.equal(declined(begin(TOKEN)).step, "password");
});

test("an invitation that comes while one is used is not taken", () => {
  const pairing = entered(entered(begin(TOKEN), "482139"), "482139");
  assert.equal(invited(pairing, "X".repeat(43)), pairing);
  assert.equal(invited(locked_, ""), locked_);
});

test("a device that was revoked is not paired", () => {
  const gone = tried(entered(locked_, "482139"), "not_paired");
  assert.deepEqual([gone.step, gone.device.account, gone.told], ["password", "", "not_paired"]);
  assert.equal(known(open, {account: ""}).device.account, "");
});
