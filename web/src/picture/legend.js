/** The legend: one entry for each kind of thing that is drawn now, in the colour that it is drawn in. Pure. */
import {mark} from "../texts.js";
import {GROUPS} from "../work/task_list.js";
import * as colours from "./colours.js";

/** Words of the elements, by the colour that they are drawn in: of the chosen task's, then of their states as the list of tasks has them. */
const ELEMENTS = new Map([
  [colours.PICKED[0], mark("chosen task's element")],
  ...[["done", "done"], ["working", "moves"], ["ready", "ready"], ["asks", "person"], ["waiting", "waits"], ["skipped", "skipped"]]
    .map(([state, word]) => [colours.BY_TASK[state][0], GROUPS[word]]),
]);

/**
 * Return the entries.
 *
 * @param {object} drawn what a cell draws (`drawn()` of cell.js): a colour, or null for what is not drawn
 * @returns {{id: string, words: string, colour: number, form: string}[]} `words`: a template; `form`: how it is drawn,
 *   `body`, `ghost`, `line`, `thin`, `point`, `axes`
 */
export function entriesOf(drawn) {
  const entries = [];
  const add = (id, words, colour, form) => {
    if (colour !== null && colour !== undefined) entries.push({id, words, colour, form});
  };
  const {closest} = drawn;
  add("both", mark("twin, and the arm as measured in the same place"), drawn.both, "body");
  add("twin", mark("twin"), drawn.twin, "body");
  add("arm", mark("arm as measured"), drawn.arm, "ghost");
  add("plan", mark("plan at the time shown"), drawn.plan, "ghost");
  add("goal", mark("goal"), drawn.goal, "ghost");
  add("path", mark("planned path of the tool"), drawn.path, "line");
  add("engaged", mark("path with the tool engaged"), drawn.engaged, "line");
  add("ahead", mark("path of the tool, still to go"), drawn.ahead, "line");
  add("travelled", mark("path of the tool, travelled"), drawn.travelled, "thin");
  if (closest) add("closest", mark("closest point of the plan: {distance} mm after {time} s ({between})"), closest.colour, "point");
  add("tool", mark("tool frame: x red, y green, z blue"), drawn.tool, "axes");
  add("carried", mark("carried by the arm"), drawn.carried, "body");
  add("standing", mark("objects of the scene"), drawn.standing, "body");
  for (const [colour, words] of ELEMENTS) if (drawn.elements.includes(colour)) add(`element-${colour.toString(16)}`, words, colour, "body");
  return entries;
}
