/**
 * What a paired device is in, and which PIN may be chosen: pure. The rule of PINs is that of console/pin.py; both pass
 * test/data/pins.json.
 *
 * `step` in one word:
 *   password  not paired, or not any more: the account and its password are typed
 *   locked    paired, and connected with the account that sees and stops: the PIN is asked
 *   trying    a PIN is being looked at by the console
 *   open      connected with the person's own account
 *   choose    an invitation is there: a PIN is chosen
 *   again     and typed again
 *   pairing   the console is asked to pair
 *
 * `told` is a word for what to say: a fault of a PIN, or of a pairing; "" for nothing.
 */

/** Digits of a PIN, and different ones among them. */
export const SHORTEST = 6;
export const LONGEST = 12;
const DIFFERENT = 3;
/** A page that nobody sees for so long asks for the PIN [ms]. */
export const HIDDEN_FOR = 60000;
const TOKEN = /^#pair=([A-Za-z0-9_-]{43})$/;

/** Return the token of an invitation that an address ends with; "" when it ends otherwise. */
export function tokenOf(hash) {
  return TOKEN.exec(hash)?.[1] ?? "";
}

/** Return in one word why a text is no PIN: `length`, `same`, `row` or `repeated`; "" when it is one. */
export function refusal(pin) {
  if (!/^[0-9]+$/.test(pin) || pin.length < SHORTEST || pin.length > LONGEST) return "length";
  if (new Set(pin).size < DIFFERENT) return "same";
  const steps = new Set([...pin].slice(1).map((digit, k) => (Number(digit) - Number(pin[k]) + 10) % 10));
  if (steps.size === 1 && (steps.has(1) || steps.has(9))) return "row";
  return (pin + pin).slice(1, -1).includes(pin) ? "repeated" : "";
}

/** Return what is typed after a press: a digit, or `back`. */
export function typed(pin, key) {
  if (key === "back") return pin.slice(0, -1);
  return /^[0-9]$/.test(key) && pin.length < LONGEST ? pin + key : pin;
}

const NOBODY = {account: "", device_account: "", number: 0, tries: 0};

/** Return the state of a page that has just begun, before the console has said whether it is paired. */
export function begin(token = "") {
  return {step: token === "" ? "password" : "choose", device: NOBODY, token, chosen: "", told: ""};
}

/** Return whether the person's account must not be used now: what goes beyond seeing and stopping is not shown. */
export function isLocked({step, device}) {
  return device.account !== "" && step !== "open";
}

/** Return the state after the console has said who this device is: {account, device_account, number, tries}. */
export function known(state, device) {
  if (device.account === "") return {...state, device: NOBODY, step: ["choose", "again", "pairing"].includes(state.step) ? state.step : "password"};
  return {...state, device, step: ["choose", "again", "pairing", "open", "trying"].includes(state.step) ? state.step : "locked"};
}

/** Return the state after a PIN was typed to its end; what is to be done then is its step. */
export function entered(state, pin) {
  if (state.step === "locked") return pin.length < SHORTEST ? {...state, told: "short"} : {...state, step: "trying", told: ""};
  if (state.step === "choose") {
    const why = refusal(pin);
    return why === "" ? {...state, step: "again", chosen: pin, told: ""} : {...state, told: `pin.${why}`};
  }
  if (state.step === "again") {
    if (pin !== state.chosen) return {...state, step: "choose", chosen: "", told: "different"};
    return {...state, step: "pairing", told: ""};
  }
  return state;
}

/** Return the state after the console's answer to a pairing. */
export function paired(state, answer, tries) {
  if (answer.ok) {
    const {account, device_account, number} = answer;
    return {...state, step: "trying", device: {account, device_account, number, tries}, token: "", chosen: "", told: ""};
  }
  // a PIN that the console does not take leaves the invitation, and so does a connection that did not come about
  if (answer.why === "pin" || answer.why === "unreachable") return {...state, step: "choose", chosen: "", told: answer.why === "pin" ? "pin.length" : "unreachable"};
  return {...state, step: state.device.account === "" ? "password" : "locked", token: "", chosen: "", told: answer.why === "code" ? "code" : "failed"};
}

/** Return the state after a PIN was tried: `why` as of connection.replace, "" for right. */
export function tried(state, why) {
  if (state.step !== "trying") return state;
  if (why === "") return {...state, step: "open", told: ""};
  if (why === "not_paired") return {...begin(), told: "not_paired"};
  if (why === "abandoned") return {...state, step: "locked"};
  return {...state, step: "locked", told: ["wrong_pin", "pin_erased", "refused"].includes(why) ? why : "unreachable"};
}

/** Return the state after a password was accepted in place of the PIN. */
export function entitled(state) {
  return {...state, step: "open", told: ""};
}

/** Return the state once nobody has seen the page for long, or the person has left. */
export function locked(state, told = "") {
  return state.device.account === "" || state.step === "choose" || state.step === "again" || state.step === "pairing" ? state : {...state, step: "locked", told};
}

/** Return the state after an invitation has come, to a page that is open. */
export function invited(state, token) {
  return token === "" || state.step === "pairing" ? state : {...state, step: "choose", token, chosen: "", told: ""};
}

/** Return the state after the person has changed their mind about being paired. */
export function declined(state) {
  return {...state, step: state.device.account === "" ? "password" : "locked", token: "", chosen: "", told: ""};
}

/**
 * Return whether nobody has seen the page for too long. Two clocks, because one may stand while a tablet sleeps, and a person can
 * set the other back.
 *
 * @param {{wall: number, steady: number}|null} since both clocks [ms] when the page was hidden; null: it is seen
 */
export function isAway(since, wall, steady) {
  return since !== null && Math.max(wall - since.wall, steady - since.steady) >= HIDDEN_FOR;
}
