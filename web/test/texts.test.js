import assert from "node:assert/strict";
import {readFileSync} from "node:fs";
import {test} from "node:test";
import {fill, makeSentences, tableOf} from "../src/sentences.js";
import {REASONS} from "../src/schemas.js";
import {languageOf, withoutLanguage} from "../src/texts.js";
import {SENTENCES, robotSays, textsIn} from "./support/sentences.js";

const {understood, wordsOf} = makeSentences(SENTENCES);

const cases = JSON.parse(readFileSync(new URL("./support/sentence_cases.json", import.meta.url), "utf8"));

// test/unit/core/test_sentences.py fills in the same ones, and compares the languages
for (const {template, values, text} of cases) {
  test(`${template} with ${JSON.stringify(values)} is ${text}`, () => assert.equal(fill(template, values), text));
}

test("a key that is missing is an error, and values are filled in as text", () => {
  const texts = textsIn("en");
  assert.throws(() => texts("page.nothing"), RangeError);
  assert.throws(() => texts("toString"), RangeError);
  assert.equal(texts("page.account", {account: "<b>$&"}), "Logged in as <b>$&");
});

test("a program's own word in a reason is what a person calls it, and a name that is such a word stays", () => {
  const said = "gateway was stopped (stop 3) and is holding: asked for by account stopped";
  assert.equal(textsIn("de").reason(said), "das Gateway wurde angehalten (Halt 3) und ist angehalten: verlangt von Konto stopped");
  assert.equal(textsIn("en").reason(said), said);
  assert.equal(textsIn("de").reason("re-plan after HOLDING"), "Neuplanung, weil der Monitor angehalten war");
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

const DIFFERS = {key: "reason.gate.differs", values: {
  joint: "joint_a3", difference: {value: 0.0123456789, unit: "rad"}, threshold: {value: 0.01, unit: "rad"},
}};
const GAVE_UP = {key: "reason.gate.gave_up", values: {held: 30.004, reason: DIFFERS}};

test("what a robot has said with key and values is said in the page's language, in deg, and in itself", () => {
  const de = textsIn("de");
  assert.match(de.said(DIFFERS, "?"), /joint_a3 .*0\.7074 °.*0\.5730 °/);
  assert.ok(de.said(GAVE_UP, "?").includes(de.said(DIFFERS, "?")));
});

test("what it has said without a key of the page, or with values that do not fit, is its own text", () => {
  const de = textsIn("de");
  const without = (changes) => ({key: DIFFERS.key, values: {...DIFFERS.values, ...changes}});
  for (const said of [
    null, undefined, 7, "reason.gate.differs", {}, {key: "reason.gate.differs"}, {key: "reason.gate.other", values: {}},
    {key: "page.title", values: {}}, {key: "constructor", values: {}}, without({joint: undefined}), without({joint: {}}),
    without({difference: 0.1}), without({difference: {value: "0.1", unit: "rad"}}), without({difference: {value: 0.1}}),
    {key: GAVE_UP.key, values: {held: "30", reason: DIFFERS}}, {key: GAVE_UP.key, values: {held: 30, reason: {key: "page.title", values: {}}}},
  ]) assert.equal(de.said(said, "the text"), "the text", JSON.stringify(said));
});

const reasons = Object.keys(SENTENCES).filter((key) => REASONS.some((each) => key.startsWith(each)));

test("a page in English needs no reasons, one in another language their English beside their own, and both have the same words else", () => {
  const [en, de] = ["en", "de"].map((language) => tableOf(SENTENCES, language));
  // what can be answered the page says itself, and by what a rehearsal has said it knows that it may be overridden
  const known = reasons.filter((key) => key.startsWith("work.answer.") || key.startsWith("review.rehearsal."));
  assert.ok(known.length > 7 && known.every((key) => key in en));
  assert.deepEqual([...Object.keys(en), ...reasons.filter((key) => !known.includes(key))].sort(), Object.keys(SENTENCES).sort());
  assert.deepEqual(Object.keys(de).sort(), Object.keys(SENTENCES).sort());
  assert.deepEqual(de["reason.gate.differs"], SENTENCES["reason.gate.differs"]);
  assert.deepEqual(de["page.title"], {de: SENTENCES["page.title"].de});
  assert.deepEqual(en["page.title"], {en: SENTENCES["page.title"].en});
});

test("what a rehearsal holds back is known by its key in every language, whatever its reasons are", () => {
  const reason = {key: "review.rehearsal.more", values: {first: "joint_a3 needs 2000 Nm", count: 2}};
  const said = robotSays("review.rehearsal.failed", {plan: "p1", reason});
  for (const language of ["en", "de"]) {
    const texts = textsIn(language);
    assert.equal(texts.keyOf(said), "review.rehearsal.failed");
    assert.equal(texts.keyOf("somebody says something"), "");
    assert.equal(texts.keyOf(""), "");
  }
});

test("a page in English shows a reason as it comes", () => {
  const en = textsIn("en");
  assert.equal(en.said(DIFFERS, "joint_a3 differs"), "joint_a3 differs");
  assert.equal(en.reason("joint_a3 differs"), "joint_a3 differs");
});

test("a reason that came as text is found in it again, and said in the page's language", () => {
  const de = textsIn("de");
  assert.ok(reasons.length > 100);
  for (const key of reasons) {
    const values = {};
    for (const [, name, decimals, form] of wordsOf(key, "en").matchAll(/\{(\w+)(?::(?:\.(\d))?(\w))?\}/g)) {
      const number = Number((1.23456789).toFixed(Number(decimals ?? 3)));
      values[name] = form === "p" || form === "q" ? {value: form === "p" ? Math.PI * 12.5 / 180 : number, unit: "rad"}
        : form === "f" || form === "g" ? number : form === "s" ? {key: "executor.where.before", values: {}} : "word";
    }
    const text = robotSays(key, values);
    assert.equal(understood(text)?.key, key, text);
    assert.equal(de.reason(text), de(key, values));
  }
});

test("a text that is no reason to the letter stays as it is", () => {
  const de = textsIn("de");
  for (const text of ["", "at 2.1 s", "this; that", "this: that", "joint_a3 differs by 0.7 deg", "Twin and arm agree.", "before the first"]) {
    assert.equal(understood(text), null, text);
    assert.equal(de.reason(text), text);
  }
  assert.equal(de.reason(undefined), undefined);
  assert.equal(textsIn("en").reason("goal reached"), "goal reached");
});
