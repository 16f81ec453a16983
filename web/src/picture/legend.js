/** The legend: one entry for each kind of thing that is drawn now, in the colour that it is drawn in. Pure. */
import * as colours from "./colours.js";

/** Words of the elements' states, as the list of tasks has them (tasks.state.*), by the colour that they are drawn in. */
const ELEMENTS = [
  ["done", "done"], ["working", "moves"], ["ready", "ready"], ["asks", "person"], ["waiting", "waits"], ["skipped", "skipped"],
].map(([state, word]) => [colours.BY_TASK[state][0], word]);

/** Return the words of an element's colour: a key of the sentences; null for a colour that no state has. */
export function elementKey(colour) {
  if (colour === colours.PICKED[0]) return "picture.legend.picked";
  const word = ELEMENTS.find(([each]) => each === colour)?.[1];
  return word === undefined ? null : `tasks.state.${word}`;
}

/** Return the words of a goal: what a person sets by whether it is reached, else the goal of the plan. */
export function goalKey(reach) {
  if (reach === null) return "picture.legend.goal";
  return `picture.reach.${reach in colours.BY_REACH ? reach : "unknown"}`;
}

/**
 * Return the entries.
 *
 * @param {object} drawn what a cell draws (`drawn()` of cell.js): a colour, or null for what is not drawn
 * @returns {{id: string, key: string, colour: number, form: string}[]} `form`: how it is drawn, `body`, `ghost`, `line`, `thin`, `point`, `axes`
 */
export function entriesOf(drawn) {
  const entries = [];
  const add = (id, colour, form, key = `picture.legend.${id}`) => {
    if (colour !== null && colour !== undefined) entries.push({id, key, colour, form});
  };
  add("both", drawn.both, "body");
  add("twin", drawn.twin, "body");
  add("arm", drawn.arm, "ghost");
  add("plan", drawn.plan, "ghost");
  add("goal", drawn.goal?.colour, "ghost", goalKey(drawn.goal?.reach ?? null));
  add("path", drawn.path, "line");
  add("engaged", drawn.engaged, "line");
  add("ahead", drawn.ahead, "line");
  add("travelled", drawn.travelled, "thin");
  add("closest", drawn.closest?.colour, "point", drawn.closest?.ofPlan ? "picture.legend.closest_of_plan" : "picture.legend.closest");
  add("tool", drawn.tool, "axes");
  add("carried", drawn.carried, "body");
  add("standing", drawn.standing, "body");
  const known = new Map(drawn.elements.map((colour) => [colour, elementKey(colour)]));
  const order = [colours.PICKED[0], ...ELEMENTS.map(([colour]) => colour)];
  for (const colour of order) if (known.get(colour)) add(`element-${colour.toString(16)}`, colour, "body", known.get(colour));
  return entries;
}
