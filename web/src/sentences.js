/**
 * The words of every sentence, in the person's language. They stand in one file, which the robot's programs read too
 * (src/construction_twin/core/sentences.json), and places in it are filled in as core/sentences.py says; test/support/sentence_cases.json
 * holds both to it. A number that lies exactly between two is rounded away from zero here.
 */
import {REASONS} from "./schemas.js";

const PLACE = /\{(\w+)(?::(?:\.(\d))?([fgqpst]))?\}/g;
const UNITS = {rad: [180 / Math.PI, "deg"], m: [1e3, "mm"]};
/** Reasons that the page needs in every language: it says what can be answered to the work's questions, and knows a rehearsal's. */
const ALWAYS = ["work.answer.", "review.rehearsal."];
const isReason = (key) => REASONS.some((each) => key.startsWith(each));

/**
 * Return what a page in one language needs of the file of sentences: its own words, and of reasons, which robots send in English, the
 * English too. A page in English needs none but `ALWAYS`: it shows what comes.
 */
export function tableOf(sentences, language) {
  const needed = Object.entries(sentences).filter(([key]) => language !== "en" || !isReason(key) || ALWAYS.some((each) => key.startsWith(each)));
  return Object.fromEntries(needed.map(([key, words]) => [key, {...(isReason(key) && {en: words.en}), [language]: words[language]}]));
}

/**
 * Return a template with its places filled in.
 *
 * @param values by name: texts, numbers, quantities `{value, unit}`; what is not given leaves its place as it is
 * @param said turns any other value into text, by its place's name, and a unit into the language's word for it
 */
export function fill(template, values, said = {value: String, unit: (unit) => unit}) {
  return template.replace(PLACE, (place, name, decimals, form) => {
    const value = Object.hasOwn(values, name) ? values[name] : undefined;
    if (value === undefined) return place;
    if (form === "f") return fixed(value, decimals);
    if (form === "g") return general(value);
    if (form !== "p" && form !== "q") return said.value(value, name);
    const [number, unit] = form === "p" ? forPeople(value) : [value.value, value.unit];
    return `${decimals === undefined ? short(number, unit) : fixed(number, decimals)} ${said.unit(unit)}`.trim();
  });
}

/** What a place in a text may be, by its form; others are one word. */
const READ = {s: "(.+?)", t: "((?:'.*?'|\".*?\") \\(\\S+\\)|\\S+?)", p: "(\\S+ \\S+?)", q: "(\\S+ \\S+?)"};
const escaped = (text) => text.replace(/[\\^$.*+?()[\]{}|]/g, "\\$&");

/** Return `wordsOf`, `canSay` and `understood` of a table of sentences: by key, words by language. */
export function makeSentences(table) {
  /** Return the words of a key in a language, with places for values; undefined: there are none. */
  const wordsOf = (key, language) => (Object.hasOwn(table, key) ? table[key][language] : undefined);

  /** Whether what came from a robot is key and values of a reason, with a value of the right kind in every place. */
  function canSay(said) {
    const {key, values} = said ?? {};
    if (typeof key !== "string" || !isReason(key) || typeof values !== "object" || values === null) return false;
    const words = wordsOf(key, "en");
    return words !== undefined && [...words.matchAll(PLACE)].every(([, name, , form]) => {
      const value = Object.hasOwn(values, name) ? values[name] : undefined;
      if (form === "p" || form === "q") return isNumberOrNull(value?.value) && typeof value.unit === "string";
      if (form === "f" || form === "g") return isNumberOrNull(value);
      return ["string", "number"].includes(typeof value) || canSay(value);
    });
  }

  // reasons that come as text, as `understood` of core/sentences.py finds them: key, places and pattern of each, its own words and
  // their longest piece; the one with the most words first
  const patterns = Object.keys(table).filter(isReason).map((key) => {
    const words = table[key].en;
    const places = [...words.matchAll(PLACE)].map(([, name, , form]) => ({name, form}));
    const own = words.split(PLACE).filter((_, k) => k % 4 === 0);
    const pattern = own.slice(1).reduce((text, each, k) => text + (READ[places[k].form] ?? "(\\S+?)") + escaped(each), escaped(own[0]));
    const longest = own.reduce((one, other) => (other.length > one.length ? other : one));
    return {key, places, own: own.join(""), longest, pattern: new RegExp(`^${pattern}$`, "s")};
  }).sort((one, other) => other.own.length - one.own.length);

  /** Return key and values of the reason whose English text this is, to the letter; null: none reads so. */
  function understood(text) {
    for (const {key, places, own, longest, pattern} of patterns) {
      const found = text.includes(longest) ? pattern.exec(text) : null;
      if (found === null) continue;
      const values = Object.fromEntries(places.map(({name, form}, k) => [name, read(form, found[k + 1])]));
      const said = {key, values};
      if (english(said) !== text) continue;
      if (/\p{L}/u.test(own) || Object.values(values).some((value) => typeof value?.key === "string")) return said;
    }
    return null;
  }

  function read(form, part) {
    if (form === "s") return understood(part) ?? part;
    if (form === "f" || form === "g") return Number(part);
    return form === "p" || form === "q" ? quantity(form, part) : part;
  }

  const english = ({key, values}) => fill(table[key].en, values, {
    value: (each) => (typeof each?.key === "string" ? english(each) : String(each)), unit: (unit) => unit,
  });

  return {wordsOf, canSay, understood};
}

function quantity(form, part) {
  const [number, unit] = part.split(" ");
  const [base, ...per] = unit.split("/");
  const inside = Object.keys(UNITS).find((each) => form === "p" && UNITS[each][1] === base);
  return inside === undefined ? {value: Number(number), unit} : {value: Number(number) / UNITS[inside][0], unit: [inside, ...per].join("/")};
}

/** Convert rad to deg, m to mm, alone or over a time; others stay. */
function forPeople({value, unit}) {
  const [base, ...per] = unit.split("/");
  if (!Object.hasOwn(UNITS, base)) return [value, unit];
  const [factor, name] = UNITS[base];
  return [value === null ? null : value * factor, [name, ...per].join("/")];
}

/** JSON has null for what is no number. */
const isNumber = (value) => typeof value === "number" && Number.isFinite(value);

const isNumberOrNull = (value) => value === null || typeof value === "number";

function fixed(value, decimals) {
  return isNumber(value) ? value.toFixed(Number(decimals)) : "nan";
}

const withoutZeros = (text) => (text.includes(".") ? text.replace(/\.?0+$/, "") : text);

function short(value, unit) {
  return !unit.includes("/") && Math.abs(value) < 1e6 ? withoutZeros(fixed(value, 6)) : general(value);
}

/** Return a number with at most six digits. */
function general(value) {
  if (!isNumber(value)) return "nan";
  const [digits, power] = value.toExponential(5).split("e");
  const exponent = Number(power);
  if (exponent >= -4 && exponent < 6) return withoutZeros(value.toFixed(5 - exponent));
  return `${withoutZeros(digits)}e${exponent < 0 ? "-" : "+"}${String(Math.abs(exponent)).padStart(2, "0")}`;
}
