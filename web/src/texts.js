/** The page's words in the person's language. */
import de from "./texts/de.js";
import en from "./texts/en.js";

const LANGUAGES = {en, de};

/** Languages that there are. */
export const languages = Object.keys(LANGUAGES);

/** Return the language to use: the one that was chosen before, else the first of the browser's that there is, else English. */
export function languageOf(chosen, wanted) {
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
 * Return the function `texts(key, values)`: the text of a key, with `{name}` replaced by `values.name`.
 *
 * A key that is missing is an error: tests compare the languages' keys.
 */
export function makeTexts(language) {
  const table = LANGUAGES[language];
  const texts = (key, values = {}) => {
    const text = table[key];
    if (text === undefined) throw new RangeError(`no text ${key} in ${language}`);
    return text.replace(/\{(\w+)\}/g, (whole, name) => (name in values ? String(values[name]) : whole));
  };
  texts.language = language;
  texts.has = (key) => key in table;
  return texts;
}
