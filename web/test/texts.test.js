import assert from "node:assert/strict";
import {test} from "node:test";
import {languageOf, makeTexts, withoutLanguage} from "../src/texts.js";
import {textsIn} from "./support/sentences.js";

test("values are filled in as text, and a place without one stays", () => {
  const texts = textsIn("en");
  assert.equal(texts("Logged in as {account}", {account: "<b>$&"}), "Logged in as <b>$&");
  assert.equal(texts("{a:.3} and {b:g} and {toString}", {a: "1.5 deg"}), "1.5 deg and {b:g} and {toString}");
});

test("the words are the language's, and English where it has none", () => {
  assert.equal(textsIn("de")("Log out"), "Abmelden");
  assert.equal(textsIn("de")("nothing of the kind {a}", {a: 1}), "nothing of the kind 1");
  assert.equal(textsIn("de")("constructor"), "constructor");
  assert.equal(textsIn("en")("Log out"), "Log out");
});

test("a program's word is what a table has for it, else itself", () => {
  const de = textsIn("de");
  assert.equal(de.word({reset: "Log out"}, "reset"), "Abmelden");
  assert.equal(de.word({reset: "Log out"}, "constructor"), "constructor");
});

test("the language is the chosen one, else the browser's, else English", () => {
  assert.equal(languageOf(["en", "de"], "de", ["en"]), "de");
  assert.equal(languageOf(["en", "de"], null, ["fr-CH", "de-CH"]), "de");
  assert.equal(languageOf(["en", "de"], "xx", ["fr"]), "en");
});

test("another language is another page of the same robots", () => {
  assert.equal(withoutLanguage("?prefix=site2&language=de&theme=dark"), "prefix=site2&theme=dark");
  assert.equal(withoutLanguage("?language=de"), "");
  assert.equal(withoutLanguage(""), "");
});

const TABLE = {
  "{joint} differs by {error:.3}": "{joint} weicht um {error} ab", "it holds: {reason}": "er hält: {reason}", "no pose": "keine Stellung",
  "gateway was stopped and is {state}: by {who}": "das Gateway wurde von {who} angehalten und ist {state}", "{a}": "<{a}>",
  stopped: "angehalten", holding: "wartend", deg: "°",
};
const german = () => makeTexts("de", TABLE);

test("what a robot has said is said by its template, with the sentences and units in it", () => {
  const de = german();
  const [differs, holds] = ["joint_a3 differs by 0.707 deg", "it holds: joint_a3 differs by 0.707 deg"];
  de.hear("kr120 view", {reason: holds, said: {
    [differs]: {template: "{joint} differs by {error:.3}", values: {joint: "joint_a3", error: "0.707 deg"}},
    [holds]: {template: "it holds: {reason}", values: {reason: differs}},
  }});
  assert.equal(de.reason(holds), "er hält: joint_a3 weicht um 0.707 ° ab");
  assert.equal(de.reason(differs), "joint_a3 weicht um 0.707 ° ab");
  assert.equal(makeTexts("en").reason(holds), holds);
});

test("a sentence without values is its own template, and what has no words comes as it is", () => {
  const de = german();
  assert.equal(de.reason("no pose"), "keine Stellung");
  for (const text of ["", "no poses", "{joint}", "constructor", undefined]) assert.equal(de.reason(text), text);
  de.hear("kr120 view", {said: {"x 1": {template: "x {n}", values: {n: "1"}}}});
  assert.equal(de.reason("x 1"), "x 1");
});

test("a state is what a person calls it, and a name that is such a word stays", () => {
  const de = german();
  const text = "gateway was stopped and is HOLDING: by stopped";
  de.hear("kr120 view", {said: {[text]: {template: "gateway was stopped and is {state}: by {who}", values: {state: "HOLDING", who: "stopped"}}}});
  assert.equal(de.reason(text), "das Gateway wurde von stopped angehalten und ist wartend");
});

test("lines and messages have their own, and a newer message of a kind takes the place of the one before", () => {
  const de = german();
  const said = (text) => ({[text]: {template: "it holds: {reason}", values: {reason: text.slice(10)}}});
  de.hear("kr120 messages", [{said: said("it holds: 1")}, {line: {said: said("it holds: 2")}}, {line: {}}, {}]);
  de.hear("kr120 view", {said: said("it holds: 3")});
  assert.equal(de.reason("it holds: 1"), "er hält: 1");
  assert.equal(de.reason("it holds: 2"), "er hält: 2");
  de.hear("kr120 view", {});
  assert.deepEqual([de.reason("it holds: 2"), de.reason("it holds: 3")], ["er hält: 2", "it holds: 3"]);
});

test("what does not make its text is not its sentence", () => {
  const de = german();
  for (const sentence of [{template: "no pose", values: {}}, {template: "it holds: {reason}"}, {template: "it holds: {reason}", values: {reason: 5}}, {}, null, 5,
    {template: "it holds: {reason}", values: {reason: "5", other: "it holds: 4"}}, {template: "{a}".repeat(9e5), values: {a: "a".repeat(9e5)}}]) {
    de.hear("kr120 view", {said: {"it holds: 5": sentence}});
    assert.equal(de.reason("it holds: 5"), "it holds: 5");
  }
});

test("a sentence that has itself as a value ends", () => {
  const de = german();
  de.hear("kr120 view", {said: {a: {template: "{a}", values: {a: "a"}}}});
  assert.equal(de.reason("a"), "<a>");
});
