/** The page's words in the person's language: English stands where it is said, and web/locale/de.po has its German. */

/** Longest sentence that is heard. */
const LONGEST = 2000;
/** A place in a template; how a number is written in it is for who wrote it. */
const PLACE = /\{(\w+)(?::[^}]*)?\}/g;
/** The unit of angles behind a number. */
const DEGREES = /(?<=\d )deg\b/g;

/** Mark a template that stands in a table, so that scripts/translations.py finds it. */
export const mark = (template) => template;

/** Places of a robot's sentence for a program's word, and these words. In another place such a word is a name. */
const OF_WORDS = ["state", "outcome", "found", "check", "quantity"];
const WORDS = [
  mark("waiting"), mark("in_sync"), mark("holding"), mark("replanning"), mark("stale"), mark("stopped"), mark("fault"), mark("idle"),
  mark("playing"), mark("stopping"), mark("pausing"), mark("paused"), mark("held"), mark("at_boundary"), mark("disconnected"),
  mark("gateway_offline"), mark("no_controller"), mark("mismatch"), mark("resync"), mark("armed"), mark("needs_reset"), mark("mirror"),
  mark("read_only"), mark("joined_running"), mark("ready"), mark("following"), mark("braking"), mark("failed"), mark("measuring"),
  mark("other_cycle"), mark("free"), mark("planning"), mark("discarding"), mark("review"), mark("withdrawing"), mark("moving"),
  mark("settling"), mark("finished"), mark("dropped"), mark("range"), mark("position"), mark("velocity"), mark("acceleration"),
  mark("jerk"), mark("braking_room"), mark("start"), mark("order"), mark("lead"), mark("values"),
];

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

/** Return whether a template and its values make a robot's text: what does not is not its sentence. */
function makes(text, sentence) {
  const {template, values} = sentence ?? {};
  if (typeof template !== "string" || template.length > LONGEST || text.length > LONGEST) return false;
  const given = Object.entries(values ?? {});
  if (!given.every(([name, each]) => typeof each === "string" && template.includes(`{${name}`))) return false;
  const places = [...template.matchAll(PLACE)];
  const length = places.reduce((sum, [place, name]) => sum - place.length + (values?.[name]?.length ?? LONGEST), template.length);
  return length === text.length && fill(template, values ?? {}) === text;
}

/** Return a template with its places filled in; a place without a value stays. */
const fill = (template, values) => template.replace(PLACE, (place, name) => (Object.hasOwn(values, name) ? String(values[name]) : place));

/**
 * Return the function `texts(template, values)`: a sentence in the page's language, in English where the table has no other words.
 *
 * @param {object} table words of the language by English template; none for English
 */
export function makeTexts(language, table = {}) {
  // by robot and kind of message: `said` of the newest
  const heard = new Map();
  const words = (template) => (Object.hasOwn(table, template) ? table[template] : undefined);
  const texts = (template, values = {}) => fill(words(template) ?? template, values);
  texts.language = language;
  /** Return what a table of templates has for a program's word; the word itself where it has nothing. */
  texts.word = (templates, word) => (Object.hasOwn(templates, word) ? texts(templates[word]) : word);
  /** Keep the templates of the sentences in what a robot has sent: `said` of a document, or of each line or message of a list. */
  texts.hear = (source, document) => {
    const said = [document].flat().flatMap((each) => Object.entries({...each?.said, ...each?.line?.said}));
    heard.set(source, new Map(said.filter(([text, sentence]) => makes(text, sentence))));
  };
  const sentenceOf = (text) => [...heard.values()].find((said) => said.has(text))?.get(text) ?? {template: text, values: {}};
  /** Return an English sentence of a robot in the page's language; where it has no words, as it came. */
  texts.reason = (text) => {
    const {template, values} = sentenceOf(text);
    const found = words(template);
    if (found === undefined) return text;
    const value = (each, place) => {
      const word = each.toLowerCase();
      if (WORDS.includes(word)) return OF_WORDS.includes(place) ? texts(word) : each;
      // a value is a part of its sentence: who sends another one gets no circle
      return each.length < text.length ? texts.reason(each).replace(DEGREES, texts("deg")) : each;
    };
    return fill(found, Object.fromEntries(Object.entries(values ?? {}).map(([place, each]) => [place, value(each, place)])));
  };
  return texts;
}
