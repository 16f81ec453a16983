/** The page's words in the person's language. */
import {fill, makeSentences} from "./sentences.js";

/** Places of a sentence that hold a program's own word, such as a state: `word.` and it are the key of what a person calls it. */
const PROGRAMS_WORDS = new Set(["state", "outcome"]);

/** Return which of the languages to use: the one that was chosen before, else the first of the browser's that there is, else English. */
export function languageOf(languages, chosen, wanted) {
  if (languages.includes(chosen)) return chosen;
  return wanted.map((tag) => tag.slice(0, 2).toLowerCase()).find((tag) => languages.includes(tag)) ?? "en";
}

/** Return an address's query without the language, which would win over the one that is chosen now; the rest stays. */
export function withoutLanguage(search) {
  const asked = new URLSearchParams(search);
  asked.delete("language");
  return asked.toString();
}

/**
 * Return the function `texts(key, values)`: the sentence of a key, with its values (sentences.js).
 *
 * A key that is missing is an error: tests compare the keys.
 *
 * @param table the language's sentences, as `tableOf` of sentences.js makes it
 */
export function makeTexts(language, table) {
  const {wordsOf, canSay, understood} = makeSentences(table);
  const texts = (key, values = {}) => {
    const words = wordsOf(key, language);
    if (words === undefined) throw new RangeError(`no text ${key} in ${language}`);
    return fill(words, values, {value, unit});
  };
  const value = (each, place) => {
    if (typeof each === "object" && each !== null) return texts(each.key, each.values);
    const word = `word.${String(each).toLowerCase()}`;
    return language !== "en" && PROGRAMS_WORDS.has(place) && texts.has(word) ? texts(word) : String(each);
  };
  const unit = (name) => {
    const [base, ...per] = name.split("/");
    return [texts.has(`unit.${base}`) ? texts(`unit.${base}`) : base, ...per].join("/");
  };
  texts.language = language;
  /** Return what a robot has said as key and values; without a key of this page, or with other values than it needs, its text. */
  texts.said = (said, text) => (canSay(said) ? texts(said.key, said.values) : texts.reason(text));
  /** Return a reason or an answer that a robot has sent as English text; where it is none of the sentences, as it came. */
  texts.reason = (text) => {
    const said = language === "en" || typeof text !== "string" ? null : understood(text);
    return said === null ? text : texts(said.key, said.values);
  };
  /** Return the key of a reason that a robot has sent as English text; "": it is none that this page knows. */
  texts.keyOf = (text) => understood(text)?.key ?? "";
  texts.has = (key) => wordsOf(key, language) !== undefined;
  return texts;
}
