/** One line about a request for a plan: what became of it, in words; the planner's own sentence follows where there is one. */
import {setText} from "../dom.js";

export function showAsking(element, asking, account, texts) {
  element.className = `plan-answer answer-${asking.state}`;
  if (asking.state === "idle") {
    setText(element, "");
    return;
  }
  const values = {account: account || "-", reason: texts.reason(asking.reason)};
  if (asking.state === "done" && typeof asking.answer.duration === "number") values.duration = asking.answer.duration.toFixed(1);
  setText(element, texts(`plan.answer.${asking.state}`, values));
}
