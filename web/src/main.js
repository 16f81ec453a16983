/** Begins the page: language, theme, store, connection, panels. */
import * as calls from "./calls/calls.js";
import {makeConnection} from "./connection.js";
import * as login from "./login.js";
import {makePage} from "./page.js";
import {readModels} from "./planning/model.js";
import {panels} from "./panels.js";
import {makeRights} from "./rights.js";
import {makeStore} from "./store.js";
import {remember, remembered, storageOf} from "./storage.js";
import {languageOf, makeTexts, withoutLanguage} from "./texts.js";

const root = document.documentElement;
const asked = new URLSearchParams(location.search);
// build.js writes a file of sentences per language but English, and its name here
const languages = ["en", ...Object.keys(SENTENCES)];
const language = languageOf(languages, asked.get("language") ?? remembered("language"), navigator.languages ?? ["en"]);
const texts = makeTexts(language, language === "en" ? {} : await (await fetch(SENTENCES[language])).json());
root.lang = language;
document.title = texts("construction_twin console");

// the device's, until a person chooses one
const device = matchMedia("(prefers-color-scheme: dark)");
let theme = asked.get("theme") ?? remembered("theme");
function showTheme() {
  root.dataset.theme = ["dark", "light"].includes(theme) ? theme : device.matches ? "dark" : "light";
  dispatchEvent(new Event("theme"));
}
function onTheme() {
  theme = root.dataset.theme === "dark" ? "light" : "dark";
  remember("theme", theme);
  showTheme();
}
device.addEventListener("change", showTheme);
showTheme();
function onLanguage() {
  remember("language", language === "en" ? "de" : "en");
  location.search = withoutLanguage(location.search);
}

const store = makeStore({hear: texts.hear});
const socket = new URL("mqtt", location.href);
socket.protocol = location.protocol === "https:" ? "wss:" : "ws:";
socket.search = "";
socket.hash = "";
// the login outlasts a reload of this tab, and goes with the tab
const keep = (login) => remember("login", JSON.stringify(login ?? []), storageOf("sessionStorage"));
const connection = makeConnection(store, {url: socket.href, prefix: asked.get("prefix") ?? "twin", keep});
store.rightsOf = makeRights(store, connection);
readModels(store, connection);
makePage(document.body, store, connection, texts, panels, {onTheme, onLanguage});
calls.make(document.querySelector(".header"), store.of("page"), connection, texts);
login.make(document.body, store, connection, texts);
// it stood there for whom this script did not reach
document.querySelector("#loading").remove();
setInterval(store.tick, 200);
connection.login(...JSON.parse(remembered("login", storageOf("sessionStorage")) ?? "[]"));
