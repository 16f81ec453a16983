/** The login: the person's MQTT account. Shown when the broker takes nobody without one, or refuses the one that was given. */
import {whyLost} from "./connection.js";
import {add, setText} from "./dom.js";

/** Make the form; it shows and hides itself. */
export function make(parent, store, connection, texts) {
  const cover = add(parent, "div", {className: "login", hidden: true});
  const form = add(cover, "form", {"aria-labelledby": "login-title"});
  add(form, "h1", {id: "login-title", text: texts("Log in")});
  const field = (name, text, options) => {
    const label = add(form, "label", {text});
    return add(label, "input", {name, required: true, ...options});
  };
  const account = field("account", texts("MQTT account"), {autocomplete: "username", autocapitalize: "none", spellcheck: "false", maxlength: "64"});
  const password = field("password", texts("Password"), {type: "password", autocomplete: "current-password"});
  const wrong = add(form, "p", {className: "wrong", role: "alert"});
  add(form, "button", {type: "submit", text: texts("Log in")});
  add(form, "p", {className: "hint", text: texts("With the account that make_site made for you. The browser may offer to keep the password; "
    + "a reload of this tab keeps the login.")});
  let wasSent = false;
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    setText(wrong, "");
    wasSent = true;
    connection.login(account.value.trim(), password.value);
  });
  // the form covers the line that tells of the connection
  const sentence = () => {
    const {state, reason} = connection;
    if (state === "refused") return reason === "refused" ? texts("The broker refuses this account or its password.") : "";
    return state === "off" ? "" : whyLost(connection, texts);
  };
  const show = () => {
    const asked = connection.state === "refused" || connection.state === "off";
    // not what a browser has filled in before anybody logs in, and not before it can offer to keep it
    if (asked && wasSent) password.value = "";
    wasSent &&= !asked;
    if (asked && cover.hidden) {
      cover.hidden = false;
      (account.value ? password : account).focus();
    }
    if (connection.state === "connected") cover.hidden = true;
    setText(wrong, cover.hidden ? "" : sentence());
  };
  store.on("connection", show);
}
