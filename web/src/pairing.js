/**
 * A paired device: its PIN in place of a password. Until the PIN is given the page is connected with an account that sees and stops,
 * and what needs more is not shown. The pad stands in the page, never over it: stop and picture stay as they are.
 *
 * Who may do what is the broker's decision; what this module locks is what a person sees.
 */
import {WITHOUT_PIN, withPin} from "./connection.js";
import {add, button, setText} from "./dom.js";
import {HIDDEN_FOR, begin, declined, entered, entitled, invited, isAway, isLocked, known, locked, paired, tokenOf, tried, typed} from "./pin_state.js";

/** Tries that a device has after it was paired. */
const TRIES = 5;
/** Longest wait for the console's answer to a pairing [ms]. */
const ANSWER_WITHIN = 20000;
const STEPS_OF_PAIRING = ["choose", "again", "pairing"];

/** Return who this device is, as the console says; null when it does not answer. */
async function ask() {
  try {
    const answer = await fetch("/paired.json", {cache: "no-store"});
    return answer.ok ? await answer.json() : null;
  } catch {
    return null;
  }
}

/** Use an invitation up; return the console's answer, `{ok: false, why: "unreachable"}` when there is none. */
async function pair(token, pin) {
  const digest = await globalThis.crypto.subtle.digest("SHA-256", new TextEncoder().encode(token));
  const hash = [...new Uint8Array(digest)].map((byte) => byte.toString(16).padStart(2, "0")).join("");
  const url = new URL("/pair", globalThis.location.href);
  url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
  url.hash = "";
  return new Promise((resolve) => {
    const socket = new WebSocket(url, ["twin-pair", hash]);
    const end = (answer) => {
      clearTimeout(late);
      resolve(answer);
      socket.close();
    };
    const late = setTimeout(() => end({ok: false, why: "unreachable"}), ANSWER_WITHIN);
    socket.addEventListener("open", () => socket.send(JSON.stringify({token, pin})));
    socket.addEventListener("message", ({data}) => end(JSON.parse(data)));
    socket.addEventListener("close", () => end({ok: false, why: "unreachable"}));
  });
}

/** What a browser gives; tests have their own. */
export const browser = {
  ask, pair,
  /** Of the invitation that the address held when the page began. */
  token: "",
  wall: () => Date.now(),
  steady: () => performance.now(),
  setTimeout: (...it) => setTimeout(...it),
  clearTimeout: (timer) => clearTimeout(timer),
  /** Take the token out of the address: neither the history nor whoever looks at the screen shall have it. */
  takeToken() {
    const token = tokenOf(location.hash);
    if (token !== "") history.replaceState(null, "", location.pathname + location.search);
    return token;
  },
  onHash: (listener) => addEventListener("hashchange", listener),
};

/**
 * Make the pad, and begin to connect.
 *
 * @param {object} login as login.js makes it
 * @param {Element} place before which the pad stands
 * @param {object} [own] as `browser`
 */
export function make(store, connection, texts, login, place, own = browser) {
  const document = place.ownerDocument;
  let state = begin(own.token);
  let pin = "";
  let away = null;
  let timer = null;
  // the form in place of the pad, because a person asked for it
  let byPassword = false;
  let asked = false;

  const section = document.createElement("section");
  section.className = "area pin";
  section.hidden = true;
  section.setAttribute("aria-label", texts("pin.area"));
  place.before(section);
  const head = add(section, "div", {className: "pin-head"});
  const title = add(head, "h2");
  const dots = add(head, "p", {className: "pin-dots", role: "status"});
  const hint = add(section, "p", {className: "pin-hint"});
  const told = add(section, "p", {className: "pin-told", role: "alert"});
  const pad = add(section, "div", {className: "pin-pad", role: "group", "aria-label": texts("pin.pad")});
  const press = (key) => {
    pin = typed(pin, key);
    if (state.told !== "") state = {...state, told: ""};
    show();
  };
  for (const digit of "123456789") button(pad, digit, () => press(digit), {className: "pin-key"});
  button(pad, texts("pin.back"), () => press("back"), {className: "pin-key", "aria-label": texts("pin.back_label")});
  button(pad, "0", () => press("0"), {className: "pin-key"});
  const ok = button(pad, texts("pin.ok"), () => enter(), {className: "pin-key pin-ok"});
  const other = button(section, "", () => elsewise(), {className: "pin-other"});
  const form = add(section, "div", {className: "pin-form", hidden: true});
  section.addEventListener("keydown", (event) => {
    if (form.contains(event.target)) return;
    if (event.key === "Enter" && !event.target.closest?.("button")) enter();
    else if (event.key === "Backspace") press("back");
    else if (/^[0-9]$/.test(event.key)) press(event.key);
    else return;
    event.preventDefault();
  });

  function put(next) {
    if (next.step !== state.step) pin = "";
    state = next;
    show();
  }

  function show() {
    const {step, device} = state;
    const pairing = STEPS_OF_PAIRING.includes(step);
    const busy = step === "trying" || step === "pairing";
    const none = step === "locked" && device.tries === 0;
    document.body.classList.toggle("is-locked", isLocked(state));
    const was = section.hidden;
    section.hidden = step === "open" || step === "password";
    // whoever had scrolled on shall see what is asked
    if (was && !section.hidden) section.scrollIntoView?.({block: "nearest"});
    // who is connected with nothing yet sees no page: then the pad stands where the form would
    login.cover(section, pairing && device.account === "" && connection.state !== "connected");
    login.place(byPassword ? form : null, pairing || isLocked(state));
    setText(title, texts(pairing ? "pin.title_pair" : "pin.title", {account: device.account}));
    setText(hint, texts(pairing ? `pin.hint.${step}` : none ? "pin.hint.none" : busy ? "pin.hint.trying" : "pin.hint.locked", {number: device.number}));
    hint.classList.toggle("is-known", step === "locked" && !none || step === "trying");
    const why = state.told === "" ? "" : texts(`pin.told.${state.told}`, {tries: device.tries});
    setText(told, why);
    login.note(step === "password" ? why : "");
    setText(dots, "●".repeat(pin.length));
    dots.setAttribute("aria-label", texts("pin.digits", {count: pin.length}));
    const typing = !byPassword && !busy && !none;
    dots.hidden = pad.hidden = !typing;
    ok.disabled = pin.length === 0;
    form.hidden = !byPassword;
    other.hidden = busy;
    setText(other, texts(pairing ? "pin.decline" : byPassword ? "pin.with_pin" : "pin.with_password"));
  }

  function elsewise() {
    if (STEPS_OF_PAIRING.includes(state.step)) {
      put(declined(state));
      if (connection.state !== "connected") void lookAgain();
      return;
    }
    byPassword = !byPassword;
    put({...state, told: ""});
  }

  /** Connect with the account that sees and stops, and ask for the PIN. */
  function lock(why = "") {
    byPassword = false;
    put(locked(state, why));
    if (state.device.account === "") return;
    connection.login(state.device.device_account, WITHOUT_PIN);
  }

  async function tryPin(secret) {
    const {account} = state.device;
    const why = await connection.replace(account, withPin(secret));
    if (why !== "" && why !== "abandoned") await refresh();
    put(tried(state, why));
    if (state.step === "password") connection.login();
  }

  /** Ask how many tries are left. */
  async function refresh() {
    const device = await own.ask();
    if (device !== null) state = {...state, device: device.account === "" ? state.device : device};
  }

  async function enter() {
    const secret = pin;
    const before = state.step;
    put(entered(state, secret));
    pin = "";
    show();
    if (before === "locked" && state.step === "trying") await tryPin(secret);
    if (before !== "again" || state.step !== "pairing") return;
    let answer = await own.pair(state.token, secret);
    if (answer.why === "unreachable") {
      // its answer may be what got lost
      const device = await own.ask();
      if (device !== null && device.account !== "" && device.number !== state.device.number) answer = {ok: true, ...device};
    }
    put(paired(state, answer, TRIES));
    if (state.step === "trying") await tryPin(secret);
  }

  /** Ask the console who this device is, and connect as that. */
  async function lookAgain() {
    asked = true;
    const device = await own.ask();
    asked = device !== null;
    put(known(state, device ?? state.device));
    if (state.device.account === "") connection.login();
    else connection.login(state.device.device_account, WITHOUT_PIN);
  }

  login.onEnter = async (account, password) => {
    if (state.device.account === "") return false;
    const why = await connection.replace(account, password);
    if (why === "") {
      byPassword = false;
      put(entitled(state));
    } else if (why !== "abandoned") {
      login.say(why);
    }
    return true;
  };

  store.on("connection", () => {
    if (connection.state === "off") lock();
    else if (connection.state === "refused") {
      if (["wrong_pin", "pin_erased"].includes(connection.reason)) {
        void refresh().then(() => lock(connection.reason));
      } else if (connection.reason === "not_paired") {
        put({...begin(state.token), told: "not_paired"});
        connection.login();
      } else if (connection.reason === "refused" && isLocked(state)) {
        // the broker knows another password by now: nothing that is kept helps
        put({...begin(), told: "refused"});
        connection.login();
      } else if (connection.reason === "login" && !asked) {
        void lookAgain();
      }
    }
    show();
  });
  document.addEventListener("visibilitychange", () => {
    const hidden = document.visibilityState === "hidden";
    own.clearTimeout(timer);
    if (hidden) {
      away = {wall: own.wall(), steady: own.steady()};
      timer = own.setTimeout(() => leave(), HIDDEN_FOR);
    } else {
      leave();
      away = null;
    }
  });
  function leave() {
    if (state.step === "open" && isAway(away, own.wall(), own.steady())) lock();
  }
  own.onHash(() => {
    const token = own.takeToken();
    // whoever brings an invitation may be somebody else
    if (token !== "" && state.step === "open") lock();
    put(invited(state, token));
  });

  show();
  return lookAgain();
}
