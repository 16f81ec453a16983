import assert from "node:assert/strict";
import {test} from "node:test";
import {languageOf, makeTexts, withoutLanguage} from "../src/texts.js";
import de from "../src/texts/de.js";
import en from "../src/texts/en.js";

test("both languages have the same keys in the same order, and the same places for values", () => {
  // what the robot says comes in English; test_status_line.py compares those words
  const own = Object.keys(de).filter((key) => !key.startsWith("line."));
  assert.deepEqual(own, Object.keys(en));
  const places = (text) => (text.match(/\{\w+\}/g) ?? []).sort();
  for (const key of Object.keys(en)) {
    assert.deepEqual(places(de[key]), places(en[key]), key);
    assert.ok(en[key].trim() && de[key].trim(), key);
  }
});

test("a key that is missing is an error, and values are filled in as text", () => {
  const texts = makeTexts("en");
  assert.throws(() => texts("page.nothing"), RangeError);
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
