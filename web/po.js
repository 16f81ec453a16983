/** Reads a file of translations (web/locale/de.po). */
import {readFileSync} from "node:fs";

const TEXTS = /((?:"(?:[^"\\]|\\.)*"\s*)+)/.source;
const ENTRY = new RegExp(`^msgid ${TEXTS}msgstr ${TEXTS}`, "gm");
const join = (texts) => texts.trim().split("\n").map((each) => JSON.parse(each)).join("");

/** Return what has been translated, by template. */
export function readTranslations(file) {
  const entries = [...readFileSync(file, "utf8").matchAll(ENTRY)].map(([, template, words]) => [join(template), join(words)]);
  return Object.fromEntries(entries.filter(([template, words]) => template !== "" && words !== ""));
}
