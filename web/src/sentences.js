/**
 * The words of every sentence, in the person's language. They stand in one file, which the robot's programs read too
 * (src/construction_twin/core/sentences.json), and places in it are filled in as core/sentences.py says; test/sentence_cases.json holds
 * both to it. A number that lies exactly between two is rounded away from zero here.
 */
import sentences from "../../src/construction_twin/core/sentences.json" with {type: "json"};

/** Languages that there are. */
export const languages = Object.keys(sentences["page.title"]);

/** Return the words of a key in a language, with places for values; undefined: there are none. */
export function wordsOf(key, language) {
  return Object.hasOwn(sentences, key) ? sentences[key][language] : undefined;
}

/** Whether what came from a robot is key and values of a reason, with a value of the right kind in every place. */
export function canSay(said) {
  const {key, values} = said ?? {};
  if (typeof key !== "string" || !key.startsWith("reason.") || typeof values !== "object" || values === null) return false;
  const words = wordsOf(key, "en");
  return words !== undefined && [...words.matchAll(PLACE)].every(([, name, , form]) => {
    const value = Object.hasOwn(values, name) ? values[name] : undefined;
    if (form === "p" || form === "q") return isNumberOrNull(value?.value) && typeof value.unit === "string";
    if (form === "f" || form === "g") return isNumberOrNull(value);
    return ["string", "number"].includes(typeof value) || canSay(value);
  });
}

const PLACE = /\{(\w+)(?::(?:\.(\d))?([fgqps]))?\}/g;
const UNITS = {rad: [180 / Math.PI, "deg"], m: [1e3, "mm"]};

/**
 * Return a template with its places filled in.
 *
 * @param values by name: texts, numbers, quantities `{value, unit}`; what is not given leaves its place as it is
 * @param said turns any other value into text, and a unit into the language's word for it
 */
export function fill(template, values, said = {value: String, unit: (unit) => unit}) {
  return template.replace(PLACE, (place, name, decimals, form) => {
    const value = Object.hasOwn(values, name) ? values[name] : undefined;
    if (value === undefined) return place;
    if (form === "f") return fixed(value, decimals);
    if (form === "g") return general(value);
    if (form !== "p" && form !== "q") return said.value(value);
    const [number, unit] = form === "p" ? forPeople(value) : [value.value, value.unit];
    return `${decimals === undefined ? short(number, unit) : fixed(number, decimals)} ${said.unit(unit)}`.trim();
  });
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
