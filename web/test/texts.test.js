import assert from "node:assert/strict";
import {readFileSync} from "node:fs";
import {test} from "node:test";
import {fill} from "../src/sentences.js";
import {languageOf, makeTexts, withoutLanguage} from "../src/texts.js";

const cases = JSON.parse(readFileSync(new URL("./support/sentence_cases.json", import.meta.url), "utf8"));

// test/unit/core/test_sentences.py fills in the same ones, and compares the languages
for (const {template, values, text} of cases) {
  test(`${template} with ${JSON.stringify(values)} is ${text}`, () => assert.equal(fill(template, values), text));
}

test("a key that is missing is an error, and values are filled in as text", () => {
  const texts = makeTexts("en");
  assert.throws(() => texts("page.nothing"), RangeError);
  assert.throws(() => texts("toString"), RangeError);
  assert.equal(texts("page.account", {account: "<b>$&"}), "Logged in as <b>$&");
});

test("the language is the chosen one, else the browser's, else English", () => {
  assert.equal(languageOf("de", ["en"]), "de");
  assert.equal(languageOf(null, ["fr-CH", "de-CH"]), "de");
  assert.equal(languageOf("xx", ["fr"]), "en");
});

test("another language is another page of the same robots", () => {
  assert.equal(withoutLanguage("?prefix=site2&language=de&theme=dark"), "prefix=site2&theme=dark");
  assert.equal(withoutLanguage("?language=de"), "");
  assert.equal(withoutLanguage(""), "");
});
