/** The login: the person's MQTT account. Shown when the broker takes nobody without one, or refuses the one that was given. */
import {add, setText} from "./dom.js";

/**
 * Make the form; it shows and hides itself. What is returned lets pairing.js put it elsewhere:
 *
 *   place(parent, held)   the form stands in `parent` (null: on its cover), and `held`: it does not show itself
 *   cover(element, shown) another element stands on the cover in the form's place, or back where it was
 *   say(reason)           a reason of connection.js under the form
 *   note(text)            why the form is there, where that is no matter of course
 *   onEnter(account, password)  called first; true: the login is its business
 *
 * @param {Element} parent
 * @param {object} store
 * @param {object} connection
 * @param {Function} texts
 */
export function make(parent, store, connection, texts) {
  const cover = add(parent, "div", {className: "login", hidden: true});
  const form = add(cover, "form", {"aria-labelledby": "login-title"});
  add(form, "h1", {id: "login-title", text: texts("login.title")});
  const field = (name, options) => {
    const label = add(form, "label", {text: texts(`login.${name}`)});
    return add(label, "input", {name, required: true, ...options});
  };
  const account = field("account", {autocomplete: "username", autocapitalize: "none", spellcheck: "false", maxlength: "64"});
  const password = field("password", {type: "password", autocomplete: "current-password"});
  const note = add(form, "p", {className: "note", hidden: true});
  const wrong = add(form, "p", {className: "wrong", role: "alert"});
  add(form, "button", {type: "submit", text: texts("login.enter")});
  add(form, "p", {className: "hint", text: texts("login.hint")});
  let held = false;
  const made = {
    onEnter: async () => false,
    place(other, isHeld) {
      const target = other ?? cover;
      if (held === isHeld && form.parentNode === target) return;
      held = isHeld;
      target.append(form);
      show();
    },
    cover(element, shown) {
      if (shown === (element.parentNode === cover)) return;
      if (shown) {
        element.before(mark);
        cover.append(element);
      } else {
        mark.replaceWith(element);
      }
      show();
    },
    note(text) {
      note.hidden = text === "";
      setText(note, text);
    },
    say(reason) {
      const why = `connection.why.${reason}`;
      setText(wrong, reason === "refused" ? texts("login.wrong") : texts("connection.lost", {why: texts.has(why) ? texts(why) : ""}));
    },
  };
  const mark = parent.ownerDocument.createComment("");
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    setText(wrong, "");
    const [name, secret] = [account.value.trim(), password.value];
    password.value = "";
    if (!await made.onEnter(name, secret)) connection.login(name, secret);
  });
  // the form covers the line that tells of the connection
  const sentence = () => {
    const {state, reason} = connection;
    if (state === "refused") return reason === "refused" ? texts("login.wrong") : "";
    const why = `connection.why.${reason}`;
    return state === "off" ? "" : texts(`connection.${state}`, {why: texts.has(why) ? texts(why) : ""});
  };
  const show = () => {
    const asked = connection.state === "refused" || connection.state === "off";
    const other = [...cover.children].some((each) => each !== form);
    form.hidden = form.parentNode === cover && other;
    if (other) cover.hidden = false;
    else if (held) cover.hidden = true;
    else if (asked && cover.hidden) {
      cover.hidden = false;
      (account.value ? password : account).focus();
    }
    if (connection.state === "connected" && !other) cover.hidden = true;
    if (!held) setText(wrong, cover.hidden ? "" : sentence());
  };
  store.on("connection", show);
  return made;
}
