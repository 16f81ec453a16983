// What is asked of the planner on `plan_request/<account>`, and what became of it. Pure: times [s] are arguments.

// A plan may take a while to be found; after so long without an answer a person is told that there was none.
export const PATIENCE_S = 60;
// The account in the topic where the broker knows none.
export const NOBODY = "console";

export function topic(name, account) {
  return `${name}/${account || NOBODY}`;
}

// A motion of all joints to {name: value}; speed: fraction of the limits, 0 for what the planner has set.
export function jointsRequest(joints, speed) {
  return {kind: "joints", joints, ...scale(speed)};
}

// A straight line of the tool to a pose.
export function lineRequest({position, orientation}, speed) {
  return {kind: "line", position, orientation, ...scale(speed)};
}

export function wayBackRequest() {
  return {kind: "way_back"};
}

// A task of the building model; "" for the one that comes next.
export function taskRequest(task) {
  return task ? {kind: "work_task", task} : {kind: "work_task"};
}

function scale(speed) {
  return speed > 0 ? {speed_scale: speed} : {};
}

// One request at a time. States: "idle", "sent" (on its way), "waiting" (the broker has it), "done", "refused" (by the planner),
// "expired" (it came too late after what the page had shown), "forbidden" (by the broker's rules), "unsent", "nobody" (nobody takes
// requests), "doubtful" (no answer, it may have arrived).
export class Asking {
  constructor(run) {
    this._run = run;
    this._number = 0;
    this._id = "";
    this._since = 0;
    this.state = "idle";
    this.answer = null;
    this.reason = "";
    this._reviewed = "";
    this._wasThere = false;
  }

  get isBusy() {
    return this.state === "sent" || this.state === "waiting";
  }

  // Return the message for a request; until it is answered no other may be asked. moment: the newest that the page has received.
  ask(request, now, moment) {
    if (this.isBusy) throw new Error("a request is under way");
    this._number += 1;
    this._id = `${this._run}-${this._number}`;
    this._since = now;
    this.state = "sent";
    this.answer = null;
    this.reason = "";
    return {id: this._id, moment, ...request};
  }

  // The broker has taken the message. code: MQTT's reason; 16: nobody has subscribed to it.
  onTaken(id, code) {
    if (id !== this._id || this.state !== "sent") return;
    this.state = code === 16 ? "nobody" : "waiting";
  }

  // The message was not published.
  onFailed(id, error) {
    if (id !== this._id || !this.isBusy) return;
    this.reason = error.message ?? "";
    if (error.reason === "refused") this.state = "forbidden";
    else if (error.reason === "unanswered") this.state = "doubtful";
    else this.state = "unsent";
  }

  // An answer of the planner; one that came before the broker's own counts as well. Returns whether it was ours.
  onAnswer(answer) {
    if (answer.id !== this._id || this.state === "idle") return false;
    this.answer = answer;
    this.reason = answer.reason;
    this._wasThere = answer.plan_id === this._reviewed;
    this.state = answer.ok ? "done" : answer.expired === true ? "expired" : "refused";
    return true;
  }

  // Id of the plan under review; "": none. That there is a plan is said while there is: it was decided, or another one came.
  onReviewed(id) {
    this._reviewed = id;
    if (this.state !== "done") return;
    if (id === this.answer.plan_id) this._wasThere = true;
    else if (this._wasThere) this.state = "idle";
  }

  // The connection has ended: what was under way may have arrived, and its answer may have been missed.
  onLost() {
    if (this.isBusy) this.state = "doubtful";
  }

  onTime(now) {
    if (this.isBusy && now - this._since >= PATIENCE_S) this.state = "doubtful";
  }
}
