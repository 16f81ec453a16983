// Made from the records by scripts/make_reference.py; check.js reads it.

/** A message on <prefix>/<robot>/view: the state of one robot. */
export const VIEW = {
  "type": "object",
  "additionalProperties": false,
  "required": [
    "version", "compatible", "robot", "online", "run", "seq", "stamp", "moment", "units", "joints", "twin", "arm", "sync", "link",
    "execution", "plan", "closest"
  ],
  "properties": {
    "version": {"const": 3},
    "compatible": {"const": 1, "since": 2},
    "robot": {"type": "string"},
    "online": {"type": "boolean"},
    "run": {"type": "string"},
    "seq": {"type": "integer", "minimum": 0},
    "stamp": {"type": "number", "minimum": 0},
    "moment": {"type": "string", "pattern": "^([0-9a-f]{8}-[0-9]{1,15})?$", "since": 3},
    "units": {"const": {"angle": "rad", "length": "m", "time": "s"}},
    "joints": {
      "type": "object",
      "additionalProperties": false,
      "required": ["names", "types"],
      "properties": {
        "names": {"type": "array", "items": {"type": "string"}},
        "types": {"type": "array", "items": {"enum": ["revolute", "prismatic"]}}
      }
    },
    "twin": {
      "type": ["object", "null"],
      "additionalProperties": false,
      "required": ["stamp", "age", "positions"],
      "properties": {
        "stamp": {"type": "number", "minimum": 0},
        "age": {"type": "number", "minimum": 0},
        "positions": {"type": "array", "items": {"type": "number"}}
      }
    },
    "arm": {
      "type": ["object", "null"],
      "additionalProperties": false,
      "required": ["stamp", "age", "positions"],
      "properties": {
        "stamp": {"type": "number", "minimum": 0},
        "age": {"type": "number", "minimum": 0},
        "positions": {"type": "array", "items": {"type": "number"}}
      }
    },
    "sync": {
      "type": ["object", "null"],
      "additionalProperties": false,
      "required": ["state", "reason", "age", "policy", "agreed", "error", "threshold", "servo_lag", "violations"],
      "properties": {
        "state": {"type": "string"},
        "reason": {"type": "string"},
        "age": {"type": "number", "minimum": 0},
        "policy": {"type": "string"},
        "agreed": {"type": "boolean"},
        "error": {"type": "array", "items": {"type": ["number", "null"]}},
        "threshold": {"type": "array", "items": {"type": ["number", "null"]}},
        "servo_lag": {"type": ["number", "null"]},
        "violations": {"type": "integer", "minimum": 0}
      }
    },
    "link": {
      "type": ["object", "null"],
      "additionalProperties": false,
      "required": ["state", "reason", "age", "gateway_state", "gateway_kind", "responsible", "round_trip_ms", "late"],
      "properties": {
        "state": {"type": "string"},
        "reason": {"type": "string"},
        "age": {"type": "number", "minimum": 0},
        "gateway_state": {"type": "string"},
        "gateway_kind": {"type": "string"},
        "responsible": {"type": "string"},
        "round_trip_ms": {"type": ["number", "null"], "since": 2},
        "late": {"type": ["integer", "null"], "minimum": 0, "since": 2}
      }
    },
    "execution": {
      "type": ["object", "null"],
      "additionalProperties": false,
      "required": ["state", "reason", "age", "plan_id", "outcome", "duration", "progress", "rate", "speed_limit", "segment"],
      "properties": {
        "state": {"type": "string"},
        "reason": {"type": "string"},
        "age": {"type": "number", "minimum": 0},
        "plan_id": {"type": "string"},
        "outcome": {"type": "string"},
        "duration": {"type": "number", "minimum": 0},
        "progress": {"type": "number", "minimum": 0, "maximum": 1},
        "rate": {"type": ["number", "null"]},
        "speed_limit": {"type": ["number", "null"]},
        "segment": {
          "type": ["object", "null"],
          "additionalProperties": false,
          "required": ["number", "name", "at_boundary"],
          "properties": {
            "number": {"type": "integer", "minimum": 0},
            "name": {"type": "string"},
            "at_boundary": {"type": "boolean"}
          },
          "since": 2
        }
      }
    },
    "plan": {"type": "string", "since": 2},
    "closest": {
      "type": ["object", "null"],
      "additionalProperties": false,
      "required": ["distance", "between", "point", "age"],
      "properties": {
        "distance": {"type": "number"},
        "between": {"type": "array", "items": {"type": "string"}, "minItems": 2, "maxItems": 2},
        "point": {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3},
        "age": {"type": "number", "minimum": 0}
      },
      "since": 2
    }
  }
};

/** The tasks of a building model, in the order in which they can be done: `WorkTasks. */
export const WORK = {
  "type": "object",
  "additionalProperties": false,
  "required": ["model", "model_hash", "schedule", "engaged", "next", "reason", "tasks", "notes"],
  "properties": {
    "stamp": {"type": "number"},
    "model": {"type": "string"},
    "model_hash": {"type": "string"},
    "schedule": {"type": "string"},
    "engaged": {"type": "boolean"},
    "reading": {"type": "boolean"},
    "next": {"type": "string"},
    "reason": {"type": "string"},
    "tasks": {
      "type": "array",
      "items": {
        "type": "object",
        "additionalProperties": false,
        "required": ["id", "name", "element", "state", "reason", "after"],
        "properties": {
          "id": {"type": "string"},
          "name": {"type": "string"},
          "element": {"type": "string"},
          "element_name": {"type": "string"},
          "state": {"type": "string"},
          "reason": {"type": "string"},
          "after": {"type": "array", "items": {"type": "string"}},
          "robot": {"type": "string"},
          "plan_id": {"type": "string"},
          "deviation_mm": {"type": ["number", "null"]},
          "deviation_deg": {"type": ["number", "null"]},
          "mass_kg": {"type": ["number", "null"]},
          "scheduled_duration": {"type": ["number", "null"]},
          "tolerance_mm": {"type": ["number", "null"]},
          "tolerance_deg": {"type": ["number", "null"]},
          "question": {"type": "string"},
          "answers": {"type": "array", "items": {"type": "string"}},
          "grip": {"type": "string"},
          "scheduled_start": {"type": "string"},
          "begun": {"type": ["number", "null"]},
          "settled": {"type": ["number", "null"]}
        }
      }
    },
    "notes": {"type": "array", "items": {"type": "string"}}
  }
};

/** A message on <prefix>/<robot>/scene: what the arm must not touch. */
export const SCENE = {
  "type": "object",
  "additionalProperties": false,
  "required": ["hash", "frame", "padding", "objects"],
  "properties": {
    "hash": {"type": "string"},
    "frame": {"type": "string"},
    "padding": {"type": "number"},
    "objects": {
      "type": "array",
      "items": {
        "type": "object",
        "additionalProperties": false,
        "required": ["name", "shape", "size", "mesh", "position", "orientation", "padding", "link", "touch"],
        "properties": {
          "name": {"type": "string"},
          "shape": {"type": "string"},
          "size": {"type": "array", "items": {"type": "number"}},
          "mesh": {"type": "string"},
          "position": {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3},
          "orientation": {"type": "array", "items": {"type": "number"}, "minItems": 4, "maxItems": 4},
          "padding": {"type": "number"},
          "link": {"type": "string"},
          "touch": {"type": "array", "items": {"type": "string"}}
        }
      }
    }
  }
};
