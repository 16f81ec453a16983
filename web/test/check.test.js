import assert from "node:assert/strict";
import {test} from "node:test";
import {check, KEYWORDS} from "../src/check.js";
import * as schemas from "../src/schemas.js";
import {view} from "./support/fake.js";

const refuses = (schema, value, sentence) => assert.throws(() => check(schema, value, "it"), (error) => {
  assert.ok(error instanceof TypeError);
  assert.equal(error.message, sentence);
  return true;
});

test("every keyword of the schemas is understood: none stands there that would not be checked", () => {
  const look = (schema) => {
    for (const name of Object.keys(schema)) assert.ok(KEYWORDS.includes(name), name);
    for (const each of Object.values(schema.properties ?? {})) look(each);
    if (schema.items) look(schema.items);
    if (schema.additionalProperties) look(schema.additionalProperties);
  };
  assert.ok(Object.keys(schemas).length > 0);
  Object.values(schemas).forEach(look);
});

test("a value of another type is refused, with its place and what was expected", () => {
  refuses({type: "object"}, [], "it that is []; expected object");
  refuses({type: ["number", "null"]}, "1", 'it that is "1"; expected number or null');
  refuses({type: "integer"}, 1.5, "it that is 1.5; expected integer");
  refuses({type: "boolean"}, 0, "it that is 0; expected boolean");
  refuses({type: "array", items: {type: "string"}}, ["a", 1], "it whose [1] is 1; expected string");
  check({type: ["number", "null"]}, null, "it");
});

test("a value outside of its bounds, and one that is none of a list, is refused", () => {
  refuses({type: "number", minimum: 0}, -1, "it that is -1; expected at least 0");
  refuses({type: "number", maximum: 1}, 2, "it that is 2; expected at most 1");
  refuses({enum: ["a", "b"]}, "c", 'it that is "c"; expected one of a, b');
  refuses({const: {a: 1}}, {a: 2}, 'it that is {"a":2}; expected {"a":1}');
  refuses({const: {a: 1}}, {a: 1, b: 1}, 'it that is {"a":1,"b":1}; expected {"a":1}');
  refuses({type: "array", minItems: 1}, [], "it that is []; expected at least 1 of them");
  refuses({type: "array", maxItems: 1}, [1, 2], "it that is [1,2]; expected at most 1 of them");
  refuses({type: "string", pattern: "^a$"}, "b", 'it that is "b"; expected a text like ^a$');
  check({const: {a: 1, b: 2}}, {b: 2, a: 1}, "it");
});

test("a key that is missing is refused, and one that is not known is left alone", () => {
  const schema = {type: "object", additionalProperties: false, required: ["a", "b"],
    properties: {a: {type: "string"}, b: {type: "string"}}};
  refuses(schema, {b: ""}, "it whose a is missing; expected it to be there");
  refuses(schema, {a: ""}, "it whose b is missing; expected it to be there");
  refuses(schema, {a: "", b: 1}, "it whose b is 1; expected string");
  check(schema, {a: "", b: "", c: 1}, "it");
  refuses({type: "object", additionalProperties: {type: "string"}}, {a: 1}, "it whose a is 1; expected string");
});

test("what every object has from its prototype is no key of a message", () => {
  refuses({type: "object", required: ["toString"], properties: {toString: {type: "string"}}}, {},
    "it whose toString is missing; expected it to be there");
  check({type: "object", properties: {}, additionalProperties: false}, JSON.parse('{"__proto__": 1, "constructor": 2}'), "it");
});

const SPEED = {limit: 1, by: "", reason: "", people: 1, person: "", since: 0, replaced: 1, replaced_person: ""};

test("each key of a view is asked for and of its type: none is shown that the robot did not say so", () => {
  check(schemas.VIEW, view(), "view");
  const look = (schema, value, path) => {
    for (const name of schema.required) {
      const at = [...path, name];
      for (const bad of [undefined, Symbol.for("no JSON")]) {
        const whole = structuredClone(view({hold: {cause: "a", since: 1}, speed: SPEED}));
        whole.expected = {stamp: 1, age: 0, positions: [0.1, -1.5]};
        whole.execution.segment = {number: 0, name: "a", at_boundary: false};
        whole.link.controller = {mode: "T1", program: "ACTIVE", override_percent: 100};
        const parent = path.reduce((found, key) => found[key], whole);
        if (bad === undefined) delete parent[name];
        else parent[name] = bad;
        assert.throws(() => check(schemas.VIEW, whole, "view"), (error) => error.message.includes(at.join(".")));
      }
      if (schema.properties[name].properties !== undefined) look(schema.properties[name], value?.[name], at);
    }
  };
  look(schemas.VIEW, view(), []);
});
