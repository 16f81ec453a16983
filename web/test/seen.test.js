import assert from "node:assert/strict";
import {test} from "node:test";
import {IN_VIEW, seenWord} from "../src/picture/seen.js";
import {GERMAN} from "./support/sentences.js";
import {UNSEEN} from "../src/panels/verdict.js";

const SEEN = {lost: false, ready: true, shown: true, inView: 1, visible: true};

test("a robot is seen while it is drawn, and at least half of the picture is in view", () => {
  assert.equal(seenWord(SEEN), "seen");
  assert.equal(seenWord({...SEEN, inView: IN_VIEW}), "seen");
});

for (const [what, change, word] of [
  ["too small", {size: {width: 299, height: 400}}, "small"], ["too low", {size: {width: 900, height: 179}}, "small"],
  ["scrolled away", {inView: 0.49}, "away"], ["in the background", {visible: false}, "away"], ["another robot's turn", {shown: false}, "away"],
  ["no model", {ready: false}, "model"], ["graphics taken away", {lost: true}, "lost"],
]) {
  test(`a robot is not seen: ${what}`, () => {
    assert.equal(seenWord({...SEEN, ...change}), word);
    assert.ok(UNSEEN[word] in GERMAN);
  });
}
