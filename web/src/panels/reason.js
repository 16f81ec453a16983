/** Why a plan cannot be approved, and where a person says why they reject or override: a reason to pick, and words of their own. */
import {add} from "../dom.js";
import {mark} from "../texts.js";

/** Longest words that console_node reads, with the reason that was picked. */
const LONGEST = 300;
/** Why a plan cannot be approved: words of verdict_state.js. */
export const BLOCKED = {
  offline: mark("Not connected: nothing can be approved."),
  none: mark("No plan is under review."),
  unfit: mark("This plan cannot be approved here."),
  decided: mark("This plan is decided."),
  sending: mark("The verdict is on its way."),
  old: mark("The arm's present state is not known here, so nothing can be approved."),
  view: mark("The robot does not say that this plan is under review."),
  obstacle: mark("Cannot be approved now: {reason}"),
  look: mark("Play the plan to its end, or open its checks, then it can be approved."),
  shown: mark("The plan must be shown for a second before it can be approved."),
  name: mark("Say your name, then the plan can be approved."),
  unseen: mark("The picture is not in view."),
  unread: mark("The sentence at the top is cut off or old: read it first."),
};

/**
 * Make the two fields.
 *
 * @param {string[]} reasons templates of what is said
 */
export function makeReason(parent, texts, reasons, changed) {
  const words = add(parent, "input", {type: "text", maxlength: LONGEST, placeholder: texts("In your own words"),
    "aria-label": texts("In your own words"), autocomplete: "off"});
  const pick = add(parent, "select", {"aria-label": texts("Reason")});
  add(pick, "option", {value: "", text: texts("Pick a reason ...")});
  for (const reason of reasons.map((each) => texts(each))) add(pick, "option", {value: reason, text: reason});
  for (const field of [pick, words]) {
    field.addEventListener("input", changed);
    field.addEventListener("change", changed);
  }
  return {
    /** What was said; "": nothing. */
    said: () => [pick.value, words.value.trim()].filter(Boolean).join(": "),
    clear() {
      pick.options[0].selected = true;
      words.value = "";
    },
    disable(is) {
      pick.disabled = words.disabled = is;
    },
  };
}
