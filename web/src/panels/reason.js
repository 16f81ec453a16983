/** Where a person says why: a reason to pick, and words of their own. */
import {add} from "../dom.js";

/** Longest words that console_node reads, with the reason that was picked. */
const LONGEST = 300;

/**
 * Make the two fields.
 *
 * @param {Element} parent
 * @param {Function} texts
 * @param {string} key of the reasons: `<key>.<word>` is what is said
 * @param {string[]} reasons
 * @param {() => void} changed
 */
export function makeReason(parent, texts, key, reasons, changed) {
  const words = add(parent, "input", {type: "text", maxlength: LONGEST, placeholder: texts("verdict.words"),
    "aria-label": texts("verdict.words"), autocomplete: "off"});
  const pick = add(parent, "select", {"aria-label": texts("verdict.reason")});
  add(pick, "option", {value: "", text: texts("verdict.pick")});
  for (const reason of reasons) add(pick, "option", {value: reason, text: texts(`${key}.${reason}`)});
  for (const field of [pick, words]) {
    field.addEventListener("input", changed);
    field.addEventListener("change", changed);
  }
  return {
    /** What was said; "": nothing. */
    said: () => [pick.value && texts(`${key}.${pick.value}`), words.value.trim()].filter(Boolean).join(": "),
    clear() {
      pick.options[0].selected = true;
      words.value = "";
    },
    disable(is) {
      pick.disabled = words.disabled = is;
    },
  };
}
