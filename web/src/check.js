/**
 * Whether a message is what its schema says (schemas.js, made from the records of the robot's programs).
 *
 * Understands of JSON Schema what those schemas use. Keys that a schema does not name are left alone, because a newer
 * sender adds some. Changes nothing, guesses nothing.
 */

/** Longest text of a wrong value that is shown. */
const MOST_SHOWN = 60;

const isObject = (value) => typeof value === "object" && value !== null && !Array.isArray(value);
const IS = {
  string: (value) => typeof value === "string",
  boolean: (value) => typeof value === "boolean",
  integer: Number.isInteger,
  number: Number.isFinite,
  null: (value) => value === null,
  array: Array.isArray,
  object: isObject,
};

/** Return whether two values of JSON are the same; the order of keys does not matter. */
function same(one, other) {
  if (typeof one !== "object" || typeof other !== "object" || one === null || other === null) return one === other;
  const keys = Object.keys(one);
  return Array.isArray(one) === Array.isArray(other) && keys.length === Object.keys(other).length
    && keys.every((key) => Object.hasOwn(other, key) && same(one[key], other[key]));
}

/** What a value must be besides its type: keyword, whether it is, and in words what was expected. */
const RULES = [
  ["const", (value, wanted) => same(value, wanted), (wanted) => JSON.stringify(wanted)],
  ["enum", (value, wanted) => wanted.includes(value), (wanted) => `one of ${wanted.join(", ")}`],
  ["type", (value, wanted) => [wanted].flat().some((type) => IS[type](value)), (wanted) => [wanted].flat().join(" or ")],
  ["minimum", (value, wanted) => typeof value !== "number" || value >= wanted, (wanted) => `at least ${wanted}`],
  ["maximum", (value, wanted) => typeof value !== "number" || value <= wanted, (wanted) => `at most ${wanted}`],
  ["minLength", (value, wanted) => typeof value !== "string" || value.length >= wanted, (wanted) => `at least ${wanted} characters`],
  ["minItems", (value, wanted) => !Array.isArray(value) || value.length >= wanted, (wanted) => `at least ${wanted} of them`],
  ["maxItems", (value, wanted) => !Array.isArray(value) || value.length <= wanted, (wanted) => `at most ${wanted} of them`],
  ["pattern", (value, wanted) => typeof value !== "string" || new RegExp(wanted).test(value), (wanted) => `a text like ${wanted}`],
];

/** Keywords of schemas that are understood: another one would be a check that is not made. */
export const KEYWORDS = [...RULES.map(([name]) => name), "properties", "required", "additionalProperties", "items"];

/** Return why a value is not what a schema says, as [path, value, what was expected]; null when it is. */
function wrong(schema, value, path) {
  for (const [name, holds, words] of RULES) {
    if (name in schema && !holds(value, schema[name])) return [path, value, words(schema[name])];
  }
  if (Array.isArray(value) && "items" in schema) {
    for (const [number, item] of value.entries()) {
      const found = wrong(schema.items, item, `${path}[${number}]`);
      if (found !== null) return found;
    }
  }
  if (!isObject(value)) return null;
  const below = (name) => (path === "" ? name : `${path}.${name}`);
  for (const name of schema.required ?? []) {
    if (!Object.hasOwn(value, name)) return [below(name), undefined, "it to be there"];
  }
  for (const [name, item] of Object.entries(value)) {
    const known = schema.properties !== undefined && Object.hasOwn(schema.properties, name);
    const rule = known ? schema.properties[name] : schema.additionalProperties || null;
    const found = rule === null ? null : wrong(rule, item, below(name));
    if (found !== null) return found;
  }
  return null;
}

/**
 * Check a message.
 *
 * @param {string} kind what it is, for the sentence
 * @throws {TypeError} where it is not what the schema says
 */
export function check(schema, message, kind) {
  const found = wrong(schema, message, "");
  if (found === null) return;
  const [path, value, expected] = found;
  const shown = value === undefined ? "missing" : (JSON.stringify(value) ?? "").slice(0, MOST_SHOWN);
  throw new TypeError(`${kind}${path === "" ? " that" : ` whose ${path}`} is ${shown}; expected ${expected}`);
}
