/**
 * Who may do what, by the list that make_site writes (`private/rights.json`): for drawing what works, and saying who can. The broker
 * decides; nothing is tried to find out. Where there is no list, nothing is known, and everything is drawn.
 */

const LISTING = "private/rights.json";

/** Return the list, if it is one, else null: by robot and person the rights, of look, operate, approve, reset. */
export function readRights(document) {
  const isObject = (value) => typeof value === "object" && value !== null && !Array.isArray(value);
  const isList = isObject(document) && isObject(document.robots) && Object.values(document.robots).every(
    (people) => isObject(people) && Object.values(people).every((rights) => Array.isArray(rights)),
  );
  return isList ? document.robots : null;
}

/** Return whether these rights are enough: a stop comes with every one but `look`. */
const isEnough = (rights, right) => (right === "stop" ? rights.some((each) => each !== "look") : rights.includes(right));

/**
 * Make what knows the rights of this page's account. It asks again with each login.
 *
 * @param {object} store tells `rights` when more or less is known
 */
export function makeRights(store, connection, get = (path) => fetch(path)) {
  let robots = null;
  let turn = 0;

  const put = (found) => {
    robots = found;
    store.rights(found);
  };
  store.on("connection", async (_, state) => {
    const mine = (turn += 1);
    if (state !== "connected") {
      // what the account may stays known while its connection is away; another account has another page
      if (connection.account === "") put(null);
      return;
    }
    let found = null;
    try {
      const answer = connection.account === "" ? null : await get(LISTING);
      found = answer?.ok ? readRights(await answer.json()) : null;
    } catch {
      // no network, or no list: nothing is known
    }
    if (mine === turn) put(found);
  });

  return {
    /** Whether this account has a right at a robot: true, false, or null where that is not known. */
    may(robot, right) {
      const people = robots?.[robot];
      return people === undefined ? null : Object.hasOwn(people, connection.account) && isEnough(people[connection.account], right);
    },

    /** The names of the others who have it; empty where that is not known. */
    who(robot, right) {
      const others = Object.entries(robots?.[robot] ?? {}).filter(([name, rights]) => name !== connection.account && isEnough(rights, right));
      return others.map(([name]) => name).sort();
    },
  };
}

/** Say who can do what this account may not. */
export const whoCan = (names, texts) => (names.length ? texts("Who can: {who}.", {who: names.join(", ")})
  : texts("Nobody is listed who can; at the robot's computer it can be done."));
