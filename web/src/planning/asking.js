// What became of a wish for a plan, on `plan_request/<account>`, in one line.

import {outcome, reasonsOf} from "../requests.js";
import {setText} from "../dom.js";
import {mark} from "../texts.js";

const ANSWERS = {
  sending: mark("Sending ..."),
  waiting: mark("Sent. The planner is looking for a way ..."),
  done: mark("There is a plan ({duration} s). It waits for somebody to look at it and approve it."),
  refused: mark("No plan: {reason}"),
  expired: mark("No plan: the request was too late after what this page had shown, and is void. Look again, then ask anew."),
  nobody: mark("Nobody takes requests at the moment: the planner does not run, or is not connected."),
  no_right: mark("Not sent: the broker refuses it to the account {account}, which may not ask for plans."),
  not_sent: mark("This did NOT go out. Ask again once the page is connected."),
  unknown: mark("No answer came. The request may have arrived: look whether a plan is under review before you ask again."),
};

// Say what became of a request (requests.js), in words; the planner's own sentence follows where there is one. That
// there is a plan is said while that is under review: then it was decided, or another one came.
export function showAsking(element, record, reviewed, account, texts) {
  const found = outcome(record);
  const {plan_id: id, duration = 0} = record.answers.at(-1) ?? {};
  const word = found === "done" && id && id !== reviewed ? "none" : found === "silent" ? "unknown" : found;
  element.className = `plan-answer answer-${word}`;
  const values = {account: account || "-", reason: reasonsOf(record, texts), duration: duration.toFixed(1)};
  setText(element, word === "none" ? "" : texts(ANSWERS[word], values));
}
