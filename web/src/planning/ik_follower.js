// Asks for joint values while the tool is dragged: the newest pose only, no faster than the planner answers it, and
// each answer is matched with its question by id. Pure: times [s] are arguments, and nothing is sent from here.

// The planner answers at most 15 in a second; a little slower, because what was sent evenly arrives unevenly.
export const PERIOD_S = 1 / 13;
// Questions that may be under way: a planner that is busy shall not be given a queue.
export const UNDER_WAY = 2;
// A question without an answer for so long is lost: it travels with QoS 0.
export const LOST_S = 1.0;

export class IkFollower {
  // run: random text, so that answers to another tab of the same account are not taken for ours
  constructor(run) {
    this._run = run;
    this._number = 0;
    this._forgotten = 0;
    this._answered = 0;
    this._newest = null;
    this._sent = -Infinity;
    this._waiting = [];
  }

  // Take the pose to which the tool was dragged: {position, orientation}. It replaces one that was not sent yet.
  drag(pose) {
    this._newest = pose;
  }

  // Return the question to send now, or null. `seed`: joint values {name: value} to begin from, or null.
  take(now, seed) {
    if (!this._newest || now < this._due(now)) return null;
    const {position, orientation} = this._newest;
    this._newest = null;
    this._sent = now;
    this._number += 1;
    this._waiting.push({number: this._number, sent: now});
    const question = {id: `${this._run}-${this._number}`, position, orientation};
    return seed ? {...question, seed} : question;
  }

  // Seconds until `take` may return the pose that waits; null when none waits.
  wait(now) {
    return this._newest ? Math.max(0, this._due(now) - now) : null;
  }

  _due(now) {
    this._waiting = this._waiting.filter((question) => now - question.sent < LOST_S);
    const free = this._waiting.length < UNDER_WAY ? -Infinity : this._waiting[0].sent + LOST_S;
    return Math.max(this._sent + PERIOD_S, free);
  }

  // Take an answer: returns it, or null for one that is another's or old.
  answer(message) {
    const [run, digits] = splitId(message.id);
    const number = Number(digits);
    if (run !== this._run || !Number.isInteger(number) || number <= this._forgotten || number > this._number) return null;
    this._waiting = this._waiting.filter((question) => question.number !== number);
    if (number <= this._answered) return null;
    this._answered = number;
    return message;
  }

  // Whether where the tool is now was answered.
  get settled() {
    return this._newest === null && this._answered === this._number;
  }

  // Whether the last question was sent and stayed without an answer.
  isLost(now) {
    return this._newest === null && this._answered < this._number && now - this._sent >= LOST_S;
  }

  // Forget what was asked: its answers count no more.
  drop() {
    this._newest = null;
    this._waiting = [];
    this._forgotten = this._number;
    this._answered = this._number;
  }
}

function splitId(id) {
  const text = typeof id === "string" ? id : "";
  const at = text.lastIndexOf("-");
  return [text.slice(0, at), /^\d{1,12}$/.test(text.slice(at + 1)) ? text.slice(at + 1) : "NaN"];
}
