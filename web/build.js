/**
 * Builds the page: `node build.js FOLDER`. Script, style and the words of each language but English get names with their hash, which the
 * console lets browsers keep for ever. Works without a network once `npm ci` has run.
 */
import {createHash} from "node:crypto";
import {cp, mkdir, readdir, readFile, rename, rm, writeFile} from "node:fs/promises";
import path from "node:path";
import {fileURLToPath} from "node:url";
import {gzipSync} from "node:zlib";
import {build} from "esbuild";
import {writePages} from "./docs_pages.js";
import {readTranslations} from "./po.js";

const here = path.dirname(fileURLToPath(import.meta.url));
const target = path.resolve(process.argv[2] ?? path.join(here, "..", ".ws", "console", "page"));
const fresh = `${target}.new`;
await rm(fresh, {recursive: true, force: true});
await mkdir(fresh, {recursive: true});

const words = JSON.stringify(readTranslations(path.join(here, "locale", "de.po")));
const german = `sentences.de.${createHash("sha256").update(words).digest("hex").slice(0, 16)}.json`;
await writeFile(path.join(fresh, german), words);
const docs = path.join(here, "..", "docs");
const result = await build({
  entryPoints: [path.join(here, "src", "main.js"), path.join(here, "src", "style.css")],
  bundle: true,
  // readers of mesh files come when they are needed
  splitting: true,
  chunkNames: "[name].[hash]",
  alias: Object.fromEntries(["STL", "Collada"].map((each) => [`three/examples/jsm/loaders/${each}Loader.js`, path.join(here, "no_loader.js")])),
  define: {SENTENCES: JSON.stringify({de: german})},
  minify: true,
  format: "esm",
  target: ["es2022", "chrome110", "firefox110", "safari16"],
  outdir: fresh,
  entryNames: "[name].[hash]",
  metafile: true,
  legalComments: "linked",
  logLevel: "warning",
});
let html = await readFile(path.join(here, "src", "index.html"), "utf8");
for (const [file, about] of Object.entries(result.metafile.outputs)) {
  if (about.entryPoint) html = html.replace(`"${path.basename(about.entryPoint)}"`, `"${path.basename(file)}"`);
}
await writeFile(path.join(fresh, "index.html"), html);
const [style] = Object.entries(result.metafile.outputs).filter(([, about]) => about.entryPoint?.endsWith("style.css")).map(([file]) => path.basename(file));
await writePages(docs, path.join(fresh, "docs"), style);
const installed = ["manifest.webmanifest", "icon.svg", "icon_call.svg", "icon_180.png", "icon_192.png", "icon_512.png", "icon_maskable.png"];
for (const name of installed) await cp(path.join(here, "src", name), path.join(fresh, name));
// what the console sends to a browser that takes it compressed
for (const name of await readdir(fresh)) {
  if (/\.(?:js|css|json|html|svg)$/.test(name)) await writeFile(path.join(fresh, `${name}.gz`), gzipSync(await readFile(path.join(fresh, name))));
}
await rm(target, {recursive: true, force: true});
await rename(fresh, target);
