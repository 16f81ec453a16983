import assert from "node:assert/strict";
import {mkdtemp, readdir, readFile, rm} from "node:fs/promises";
import os from "node:os";
import path from "node:path";
import {test} from "node:test";
import {fileURLToPath} from "node:url";
import {anchorOf, bodyOf, writePages} from "../docs_pages.js";

const docs = path.join(path.dirname(fileURLToPath(import.meta.url)), "..", "..", "docs");

test("markdown becomes elements, and its text stays text", () => {
  assert.equal(bodyOf("# A `b` & <i>\n\ntext **bold** `a<b`\nmore\n- one\n  two\n- three\n\n```\n<x>\n```"),
    '<h1 id="a-b--i">A <code>b</code> &amp; &lt;i&gt;</h1>\n<p>text <strong>bold</strong> <code>a&lt;b</code> more</p>\n'
    + '<ul><li>one two</li><li>three</li></ul>\n<pre tabindex="0">&lt;x&gt;</pre>');
  assert.equal(bodyOf("| a | b |\n|---|---|\n| `x\\|y` | z |"),
    "<table><thead><tr><th>a</th><th>b</th></tr></thead><tbody><tr><td><code>x|y</code></td><td>z</td></tr></tbody></table>");
});

test("a link leads to another page of the docs or stays text", () => {
  assert.equal(bodyOf("[a](b/c.md#d) [e](#f) [g](https://h) [i](javascript:x) [j](../k.md)", (file) => file === "b/c.md"),
    '<p><a href="b/c.html#d">a</a> <a href="#f">e</a> g i j</p>');
});

test("every page of the docs is written, and every anchor that one names is there", async () => {
  const folder = await mkdtemp(path.join(os.tmpdir(), "pages-"));
  try {
    await writePages(docs, folder, "style.css");
    const names = (await readdir(folder, {recursive: true})).filter((name) => name.endsWith(".html"));
    assert.ok(names.length > 10);
    const pages = new Map();
    for (const name of names) pages.set(name, await readFile(path.join(folder, name), "utf8"));
    let links = 0;
    for (const [name, text] of pages) {
      assert.doesNotMatch(text, /<script|<style|\son\w+=|style=|<!--/, name);
      assert.match(text, /^<html lang="en">$/m, name);
      assert.ok(text.includes(`href="${"../".repeat(name.split(path.sep).length)}style.css"`), name);
      for (const [, target, anchor] of text.matchAll(/<a href="([^"#]*)(?:#([^"]*))?">/g)) {
        const file = target === "" ? name : path.join(path.dirname(name), target);
        assert.ok(pages.has(file), `${name}: ${target}`);
        if (anchor) assert.ok(pages.get(file).includes(`id="${anchor}"`), `${name}: ${target}#${anchor}`);
        links += 1;
      }
    }
    assert.ok(links > 50, `${links}`);
  } finally {
    await rm(folder, {recursive: true});
  }
});

test("anchors are those that the status line names", () => {
  assert.equal(anchorOf("`NEEDS_RESET`: call `reset`"), "needs_reset-call-reset");
  assert.equal(anchorOf("3. Look"), "3-look");
});
