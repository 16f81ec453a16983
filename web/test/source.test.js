import assert from "node:assert/strict";
import {readdirSync, readFileSync} from "node:fs";
import path from "node:path";
import {test} from "node:test";
import {fileURLToPath} from "node:url";

const root = path.join(path.dirname(fileURLToPath(import.meta.url)), "..", "src");
const files = readdirSync(root, {recursive: true}).filter((name) => name.endsWith(".js"));
const read = (name) => readFileSync(path.join(root, name), "utf8");

test("nothing that came from elsewhere can become markup or a program", () => {
  const wrong = /innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\(|new Function|createContextualFragment|srcdoc|DOMParser/;
  assert.ok(files.length > 5);
  for (const name of files) assert.doesNotMatch(read(name), wrong, name);
});

test("the page names no other server", () => {
  const own = /https?:\/\/(www\.w3\.org)/g;
  for (const name of [...files, "index.html", "style.css", "icon.svg", "icon_call.svg", "manifest.webmanifest"]) {
    assert.doesNotMatch(read(name).replace(own, ""), /(https?|wss?):\/\/\w/, name);
  }
});

test("no script or style stands in the page itself", () => {
  assert.doesNotMatch(read("index.html"), /<style|style=|<script(?![^>]*src=)|\son\w+=/);
  for (const name of files) assert.doesNotMatch(read(name), /setAttribute\("style"|setAttribute\("on|style: "/, name);
});
