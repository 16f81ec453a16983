/**
 * The pages of docs/ as HTML, for the links of the status line: a tablet on a site has no other way to read them.
 *
 * Reads the Markdown that docs/ is written in: headings, paragraphs, lists, tables, code, links. Everything is escaped; a link leads to
 * another of these pages or stays text. No script and no style stands in a page.
 */
import {mkdir, readFile, readdir, writeFile} from "node:fs/promises";
import path from "node:path";

const escaped = (text) => text.replace(/[&<>"]/g, (letter) => ({"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;"})[letter]);

/** Return the anchor of a heading, as GitHub makes it. */
export function anchorOf(heading) {
  return heading.replace(/\[([^\]]*)\]\([^)]*\)/g, "$1").toLowerCase().replace(/[^\p{L}\p{N}_\- ]/gu, "").replaceAll(" ", "-");
}

function linked(text, target, isThere) {
  const [, file, anchor] = /^([^#]*)(#[\w%-]*)?$/.exec(target) ?? [];
  if (file === undefined || !(file === "" || /^[\w./-]+\.md$/.test(file) && isThere(file))) return text;
  return `<a href="${file.replace(/\.md$/, ".html")}${anchor ?? ""}">${text}</a>`;
}

/** Return a line with code, bold, emphasis and links. */
function inline(text, isThere) {
  return text.split(/(`[^`]+`)/).map((part, k) => {
    if (k % 2) return `<code>${escaped(part.slice(1, -1))}</code>`;
    return escaped(part)
      .replace(/!\[([^\]]*)\]\([^)]*\)/g, "$1")
      .replace(/\*\*([^*]+)\*\*/g, "<strong>$1</strong>")
      .replace(/(^|[\s(])\*([^*\s][^*]*)\*/g, "$1<em>$2</em>");
  }).join("").replace(/\[((?:[^\]<]|<\/?(?:code|em|strong)>)*)\]\(([^)\s]*)\)/g, (_, words, target) => linked(words, target, isThere));
}

const ITEM = /^(\s*)(?:[-*]|\d+\.)\s+(.*)$/;
const isTable = (line) => /^\s*\|.*\|\s*$/.test(line);
const cells = (line, isThere) => line.trim().slice(1, -1).split(/(?<!\\)\|/).map((cell) => inline(cell.trim().replaceAll("\\|", "|"), isThere));

/** Return the body of a page; `isThere` says whether a page that a link names is one of these. */
export function bodyOf(markdown, isThere = () => true) {
  const lines = markdown.replace(/<!--[^]*?-->/g, "").split("\n");
  const out = [];
  let k = 0;
  const until = (ends) => {
    const words = [];
    while (k < lines.length && lines[k].trim() !== "" && (words.length === 0 || !ends.test(lines[k]))) words.push(lines[k++].trim());
    return words.join(" ");
  };
  while (k < lines.length) {
    const line = lines[k];
    const heading = /^(#{1,6})\s+(.*)$/.exec(line);
    const item = ITEM.exec(line);
    if (/^\s*```/.test(line)) {
      const code = [];
      for (k += 1; k < lines.length && !/^\s*```/.test(lines[k]); k += 1) code.push(lines[k]);
      k += 1;
      out.push(`<pre tabindex="0">${escaped(code.join("\n"))}</pre>`);
    } else if (heading) {
      const [, {length: level}, words] = heading;
      out.push(`<h${level} id="${escaped(anchorOf(words))}">${inline(words, isThere)}</h${level}>`);
      k += 1;
    } else if (isTable(line)) {
      const rows = [];
      for (; k < lines.length && isTable(lines[k]); k += 1) if (!/^\s*\|[\s:|-]+\|\s*$/.test(lines[k])) rows.push(cells(lines[k], isThere));
      const [first, ...rest] = rows;
      out.push(`<table><thead><tr>${first.map((cell) => `<th>${cell}</th>`).join("")}</tr></thead><tbody>${
        rest.map((row) => `<tr>${row.map((cell) => `<td>${cell}</td>`).join("")}</tr>`).join("")}</tbody></table>`);
    } else if (item) {
      const tag = /^\s*\d/.test(line) ? "ol" : "ul";
      const items = [];
      while (k < lines.length && ITEM.test(lines[k])) {
        lines[k] = ITEM.exec(lines[k])[2];
        items.push(`<li>${inline(until(/^\s*(?:[-*]|\d+\.)\s|^\s*```/), isThere)}</li>`);
      }
      out.push(`<${tag}>${items.join("")}</${tag}>`);
    } else if (line.trim() === "") {
      k += 1;
    } else {
      out.push(`<p>${inline(until(/^\s*(?:[-*]|\d+\.)\s|^\s*```|^#{1,6}\s|^\s*\|.*\|\s*$/), isThere)}</p>`);
    }
  }
  return out.join("\n");
}

const namesIn = async (folder) => (await readdir(folder, {recursive: true})).filter((name) => name.endsWith(".md"))
  .map((name) => name.replaceAll(path.sep, "/")).sort();

/** Write every page of a folder of Markdown below another folder; `style` is the style sheet's name in the page's own folder. */
export async function writePages(from, to, style) {
  const names = await namesIn(from);
  for (const name of names) {
    const markdown = await readFile(path.join(from, name), "utf8");
    const up = "../".repeat(name.split("/").length);
    const title = /^#\s+(.*)$/m.exec(markdown)?.[1] ?? name;
    const file = path.join(to, name.replace(/\.md$/, ".html"));
    await mkdir(path.dirname(file), {recursive: true});
    await writeFile(file, `<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>${escaped(title)}</title>
<link rel="stylesheet" href="${up}${style}">
</head>
<body class="manual"><main>
${bodyOf(markdown, (file) => names.includes(path.join(path.dirname(name), file)))}
</main></body>
</html>
`);
  }
}
