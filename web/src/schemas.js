// Made from the records by scripts/make_reference.py; check.js and sentences.js read it.

/** A message on <prefix>/<robot>/view: the state of one robot. */
export const VIEW = {
  "type": "object",
  "additionalProperties": false,
  "required": [
    "version", "compatible", "robot", "online", "run", "seq", "stamp", "moment", "units", "joints", "twin", "arm", "expected",
    "sync", "link", "execution", "plan", "closest", "hold", "approval_obstacle", "speed"
  ],
  "properties": {
    "version": {"const": 6},
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
    "expected": {
      "type": ["object", "null"],
      "additionalProperties": false,
      "required": ["stamp", "age", "positions"],
      "properties": {
        "stamp": {"type": "number", "minimum": 0},
        "age": {"type": "number", "minimum": 0},
        "positions": {"type": "array", "items": {"type": "number"}}
      },
      "since": 6
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
      "required": ["state", "reason", "age", "gateway_state", "gateway_kind", "responsible", "round_trip_ms", "late", "controller"],
      "properties": {
        "state": {"type": "string"},
        "reason": {"type": "string"},
        "age": {"type": "number", "minimum": 0},
        "gateway_state": {"type": "string"},
        "gateway_kind": {"type": "string"},
        "responsible": {"type": "string"},
        "round_trip_ms": {"type": ["number", "null"], "since": 2},
        "late": {"type": ["integer", "null"], "minimum": 0, "since": 2},
        "controller": {
          "type": ["object", "null"],
          "additionalProperties": false,
          "required": ["mode", "program", "override_percent"],
          "properties": {
            "mode": {"type": "string"},
            "program": {"type": "string"},
            "override_percent": {"type": ["number", "null"]}
          },
          "since": 5
        }
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
    },
    "hold": {
      "type": ["object", "null"],
      "additionalProperties": false,
      "required": ["cause", "since"],
      "properties": {"cause": {"type": "string"}, "since": {"type": "number", "minimum": 0}},
      "since": 4
    },
    "approval_obstacle": {"type": "string", "since": 4},
    "speed": {
      "type": ["object", "null"],
      "additionalProperties": false,
      "required": ["limit", "by", "reason", "people", "person", "since", "replaced", "replaced_person"],
      "properties": {
        "limit": {"type": "number"},
        "by": {"type": "string"},
        "reason": {"type": "string"},
        "people": {"type": "number"},
        "person": {"type": "string"},
        "since": {"type": "number", "minimum": 0},
        "replaced": {"type": "number"},
        "replaced_person": {"type": "string"}
      },
      "since": 5
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

/** One line of <prefix>/<robot>/screen: the status line. */
export const SCREEN = {
  "type": "array",
  "items": {
    "type": "object",
    "additionalProperties": false,
    "required": ["topic", "sentence"],
    "properties": {
      "topic": {"type": "string"},
      "state": {"type": "string"},
      "words": {"type": "string"},
      "values": {"type": "object", "additionalProperties": {"type": "string"}},
      "level": {"type": "integer"},
      "sentence": {"type": "string"},
      "reason": {"type": "string"},
      "said": {"type": ["object", "null"], "additionalProperties": {}},
      "waits_for": {"type": "string"},
      "who": {"type": "string"},
      "todo": {"type": "string"},
      "page": {"type": "string"}
    }
  }
};

/** A message on <prefix>/<robot>/plan: the plan under review. */
export const PLAN = {
  "type": "object",
  "additionalProperties": false,
  "required": [
    "id", "hash", "source", "planner", "scene", "frame", "created_ns", "duration", "planning_time", "joints", "start", "goal",
    "waypoints", "tool_path", "clearance", "use", "trajectory"
  ],
  "properties": {
    "id": {"type": "string", "minLength": 1},
    "hash": {"type": "string"},
    "source": {"type": "string"},
    "planner": {"type": "string"},
    "scene": {"type": "string"},
    "frame": {"type": "string"},
    "created_ns": {"type": "integer"},
    "duration": {"type": "number"},
    "planning_time": {"type": "number"},
    "joints": {"type": "array", "items": {"type": "string"}},
    "start": {"type": "array", "items": {"type": "number"}},
    "goal": {"type": "array", "items": {"type": "number"}},
    "waypoints": {"type": "integer"},
    "tool_path": {"type": "array", "items": {"type": "array", "items": {"type": "number"}}},
    "tool_path_deviation": {"type": "number"},
    "clearance": {
      "type": ["object", "null"],
      "additionalProperties": false,
      "required": ["distance", "time", "between", "point"],
      "properties": {
        "distance": {"type": ["number", "null"]},
        "time": {"type": "number"},
        "between": {"type": "array", "items": {"type": "string"}},
        "point": {"type": "array", "items": {"type": "number"}}
      }
    },
    "use": {
      "type": "object",
      "additionalProperties": false,
      "required": ["velocity", "acceleration", "jerk"],
      "properties": {
        "velocity": {"type": "array", "items": {"type": "number"}},
        "acceleration": {"type": "array", "items": {"type": "number"}},
        "jerk": {"type": "array", "items": {"type": "number"}}
      }
    },
    "trajectory": {"type": ["object", "null"], "additionalProperties": {}},
    "tool": {"type": ["string", "null"]},
    "task": {"type": ["string", "null"]},
    "content": {"type": ["string", "null"]},
    "segments": {
      "type": ["array", "null"],
      "items": {
        "type": "object",
        "additionalProperties": false,
        "required": ["name", "end", "tool_path_end", "engaged", "requires", "switches", "scene", "scene_after", "put", "remove"],
        "properties": {
          "name": {"type": "string"},
          "end": {"type": "number"},
          "tool_path_end": {"type": "integer"},
          "engaged": {"type": "boolean"},
          "requires": {"type": "object", "additionalProperties": {"type": "boolean"}},
          "switches": {
            "type": "array",
            "items": {
              "type": "object",
              "additionalProperties": false,
              "required": ["output", "value", "confirm", "timeout"],
              "properties": {
                "output": {"type": "string"},
                "value": {"type": "boolean"},
                "confirm": {"type": "object", "additionalProperties": {"type": "boolean"}},
                "timeout": {"type": "number"}
              }
            }
          },
          "scene": {"type": "string"},
          "scene_after": {"type": "string"},
          "put": {"type": "array", "items": {"type": "string"}},
          "remove": {"type": "array", "items": {"type": "string"}}
        }
      }
    }
  }
};

/** A message on <prefix>/<robot>/path: the tool's path of the plan that is played. */
export const PATH = {
  "type": "object",
  "additionalProperties": false,
  "required": ["plan_id", "times", "tool_path"],
  "properties": {
    "plan_id": {"type": "string", "minLength": 1},
    "times": {"type": "array", "items": {"type": "number"}},
    "tool_path": {"type": "array", "items": {"type": "array", "items": {"type": "number"}}}
  }
};

/** The result of one rehearsal: `Rehearsal. */
export const REHEARSAL = {
  "type": "object",
  "additionalProperties": false,
  "required": [],
  "properties": {
    "plan_id": {"type": "string"},
    "plan_hash": {"type": "string"},
    "scene": {"type": "string"},
    "tool": {"type": "string"},
    "inputs": {"type": "string"},
    "state": {"type": "string"},
    "reasons": {"type": "array", "items": {"type": "string"}},
    "axes": {
      "type": "array",
      "items": {
        "type": "object",
        "additionalProperties": false,
        "required": ["joint", "peak", "time", "rms", "gravity", "limit", "estimated"],
        "properties": {
          "joint": {"type": "string"},
          "peak": {"type": "number"},
          "time": {"type": "number"},
          "rms": {"type": "number"},
          "gravity": {"type": "number"},
          "limit": {"type": "number"},
          "estimated": {"type": "boolean"}
        }
      }
    },
    "payload": {
      "type": "object",
      "additionalProperties": false,
      "required": [],
      "properties": {
        "mass": {"type": "number"},
        "estimated": {"type": "boolean"},
        "across": {"type": "number"},
        "along": {"type": "number"},
        "inertia": {"type": "number"},
        "rated_mass": {"type": "number"},
        "rated_inertia": {"type": "number"},
        "rated_across": {"type": "number"},
        "rated_along": {"type": "number"}
      }
    },
    "tracking": {"type": ["number", "null"]},
    "tracking_joint": {"type": "string"},
    "braking": {
      "type": "object",
      "additionalProperties": false,
      "required": [],
      "properties": {
        "time": {"type": "number"},
        "seconds": {"type": "number"},
        "distance": {"type": "number"},
        "joint": {"type": "string"},
        "angle": {"type": "number"},
        "usage": {"type": "number"}
      }
    },
    "worst_time": {"type": "number"},
    "worst_pose": {"type": "array", "items": {"type": "number"}},
    "contacts": {
      "type": "array",
      "items": {
        "type": "object",
        "additionalProperties": false,
        "required": ["first", "second", "time", "point", "force", "seconds"],
        "properties": {
          "first": {"type": "string"},
          "second": {"type": "string"},
          "time": {"type": "number"},
          "point": {"type": "array", "items": {"type": "number"}},
          "force": {"type": "number"},
          "seconds": {"type": "number"}
        }
      }
    },
    "objects": {
      "type": "array",
      "items": {
        "type": "object",
        "additionalProperties": false,
        "required": ["name", "released", "moved", "turned", "fell", "resting"],
        "properties": {
          "name": {"type": "string"},
          "released": {"type": ["number", "null"]},
          "moved": {"type": "number"},
          "turned": {"type": "number"},
          "fell": {"type": "number"},
          "resting": {"type": "boolean"}
        }
      }
    },
    "grip": {
      "type": "object",
      "additionalProperties": false,
      "required": [],
      "properties": {
        "name": {"type": "string"},
        "cups": {"type": "integer"},
        "time": {"type": "number"},
        "usage": {"type": "number"}
      }
    },
    "energy": {"type": ["number", "null"]},
    "duration": {"type": "number"},
    "took": {"type": "number"},
    "settle_took": {"type": "number"},
    "engine": {"type": "string"},
    "remarks": {"type": "array", "items": {"type": "string"}},
    "hash": {"type": "string"},
    "stamp": {"type": "number"}
  }
};

/** A message on <prefix>/<robot>/review/ack. */
export const REVIEW_ACK = {
  "type": "object",
  "additionalProperties": false,
  "required": [],
  "properties": {
    "plan_id": {"type": "string"},
    "plan_hash": {"type": "string"},
    "verdict": {"type": "string"},
    "reviewer": {"type": "string"},
    "account": {"type": "string"},
    "ok": {"type": "boolean"},
    "reason": {"type": "string"},
    "expired": {"type": "boolean"}
  }
};

/** A message on <prefix>/<robot>/stop/ack. */
export const STOP_ACK = {
  "type": "object",
  "additionalProperties": false,
  "required": [],
  "properties": {
    "id": {"type": "string"},
    "account": {"type": "string"},
    "ok": {"type": "boolean"},
    "reason": {"type": "string"},
    "by": {"type": "string"},
    "expired": {"type": "boolean"}
  }
};

/** A message on <prefix>/<robot>/plan_request/ack. */
export const PLAN_REQUEST_ACK = {
  "type": "object",
  "additionalProperties": false,
  "required": [],
  "properties": {
    "id": {"type": "string"},
    "account": {"type": "string"},
    "kind": {"type": "string"},
    "ok": {"type": "boolean"},
    "reason": {"type": "string"},
    "plan_id": {"type": "string"},
    "plan_hash": {"type": "string"},
    "duration": {"type": "number"},
    "expired": {"type": "boolean"}
  }
};

/** A message on <prefix>/<robot>/ik/ack/<account>. */
export const IK_ACK = {
  "type": "object",
  "additionalProperties": false,
  "required": [],
  "properties": {
    "id": {"type": "string"},
    "reach": {"type": "string"},
    "joints": {"type": ["object", "null"], "additionalProperties": {"type": "number"}},
    "sentence": {"type": "string"},
    "between": {"type": "array", "items": {"type": "string"}}
  }
};

/** A message on <prefix>/<robot>/answer/ack. */
export const ANSWER_ACK = {
  "type": "object",
  "additionalProperties": false,
  "required": [],
  "properties": {
    "id": {"type": "string"},
    "account": {"type": "string"},
    "task": {"type": "string"},
    "ok": {"type": "boolean"},
    "reason": {"type": "string"},
    "expired": {"type": "boolean"}
  }
};

/** A message on <prefix>/<robot>/acknowledge/ack. */
export const ACKNOWLEDGE_ACK = {
  "type": "object",
  "additionalProperties": false,
  "required": [],
  "properties": {
    "id": {"type": "string"},
    "account": {"type": "string"},
    "message": {"type": "string"},
    "ok": {"type": "boolean"},
    "reason": {"type": "string"}
  }
};

/** A message on <prefix>/<robot>/speed/ack. */
export const SPEED_ACK = {
  "type": "object",
  "additionalProperties": false,
  "required": [],
  "properties": {
    "id": {"type": "string"},
    "account": {"type": "string"},
    "limit": {"type": "number"},
    "ok": {"type": "boolean"},
    "reason": {"type": "string"},
    "expired": {"type": "boolean"}
  }
};

/** One message of <prefix>/<robot>/messages. */
export const MESSAGES = {
  "type": "array",
  "items": {
    "type": "object",
    "additionalProperties": false,
    "required": ["id", "at", "line"],
    "properties": {
      "id": {"type": "string"},
      "at": {"type": "number"},
      "line": {
        "type": "object",
        "additionalProperties": false,
        "required": ["topic", "sentence"],
        "properties": {
          "topic": {"type": "string"},
          "state": {"type": "string"},
          "words": {"type": "string"},
          "values": {"type": "object", "additionalProperties": {"type": "string"}},
          "level": {"type": "integer"},
          "sentence": {"type": "string"},
          "reason": {"type": "string"},
          "said": {"type": ["object", "null"], "additionalProperties": {}},
          "waits_for": {"type": "string"},
          "who": {"type": "string"},
          "todo": {"type": "string"},
          "page": {"type": "string"}
        }
      },
      "until": {"type": ["number", "null"]},
      "acknowledged_by": {"type": "string"},
      "acknowledged_at": {"type": ["number", "null"]}
    }
  }
};

/** Beginnings of the keys of reasons and answers, as core/sentences.py has them. */
export const REASONS = [
  "reason.", "executor.", "review.", "link.", "gateway.", "motion.", "work.", "startup.", "expected.", "telegram.", "ifc.",
  "rehearsal.", "physics."
];
