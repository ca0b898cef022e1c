// Makes ../koop_view/page/index.html: the whole page in one file.
//
//   node build.mjs                  writes it
//   node build.mjs --out FILE       writes another file
//   node build.mjs --tests FOLDER   bundles the tests into FOLDER, for `node --test`

import { createHash } from "node:crypto";
import { mkdirSync, readdirSync, readFileSync, writeFileSync } from "node:fs";
import { basename, dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";

const HERE = dirname(fileURLToPath(import.meta.url));
const HOUSE = process.env.KOOP_PAGE_CSS ?? join(HERE, "../koop_view/report/page.css"); // the report's style
const argument = (name) => { const i = process.argv.indexOf(name); return i < 0 ? undefined : process.argv[i + 1]; };
const read = (...path) => readFileSync(join(HERE, ...path), "utf8");
const common = { bundle: true, target: "es2022", absWorkingDir: HERE, logLevel: "warning" };

// What the page is made of. The test that has no Node.js compares this, so the order and the separator are fixed.
export function sourcesHash() {
  const own = ["build.mjs", "package-lock.json", ...readdirSync(join(HERE, "src")).map((name) => `src/${name}`)].sort();
  const hash = createHash("sha256");
  for (const name of own) hash.update(`${name}\n`).update(readFileSync(join(HERE, name)));
  return hash.update("page.css\n").update(readFileSync(HOUSE)).digest("hex");
}

// The licences of what is bundled, each text once.
function licences(inputs) {
  const packages = [...new Set(inputs.map((path) => /node_modules\/((?:@[^/]+\/)?[^/]+)\//.exec(path)?.[1]).filter(Boolean))].sort();
  const texts = new Map();
  for (const name of packages) {
    const { version, license, author } = JSON.parse(read("node_modules", name, "package.json"));
    const file = readdirSync(join(HERE, "node_modules", name)).find((entry) => /^licen[cs]e/i.test(entry));
    const holder = typeof author === "object" ? author.name : author;
    const text = file ? read("node_modules", name, file).trim() : `${license} license, ${holder}; the package has no text of its own.`;
    texts.set(text, [...(texts.get(text) ?? []), `${name} ${version}`]);
  }
  return [...texts].map(([text, names]) => `${names.join(", ")}:\n\n${text}`).join("\n\n----\n\n").replaceAll("*/", "* /");
}

async function page() {
  const done = await build({ ...common, entryPoints: ["src/main.ts"], format: "iife", minify: true, write: false, metafile: true, charset: "utf8", legalComments: "none" });
  const style = await build({
    ...common, minify: true, write: false, loader: { ".css": "css" },
    stdin: { contents: [read("node_modules/uplot/dist/uPlot.min.css"), readFileSync(HOUSE, "utf8"), read("src/style.css")].join("\n"), loader: "css" },
  });
  const notice = `/*\nIn this page, beside its own code (Apache-2.0):\n\n${licences(Object.keys(done.metafile.inputs))}\n*/\n`;
  const script = notice + done.outputFiles[0].text.trim() + "\n";
  if (/<\/script|<!--/i.test(script)) throw new Error("the script would end before its end");
  const made = `<!-- Made of the sources in src/koop_view/web (npm ci && npm run build): edit those. -->\n<meta name="sources" content="${sourcesHash()}">\n`;
  return read("src/page.html")
    .replace("<meta charset=\"utf-8\">\n", (found) => found + made)
    .replace("/*STYLE*/", () => style.outputFiles[0].text.trim())
    .replace("/*SCRIPT*/", () => `\n${script}`);
}

const tests = argument("--tests");
if (tests !== undefined) {
  const names = readdirSync(join(HERE, "test")).filter((name) => name.endsWith(".test.ts"));
  await build({ ...common, platform: "node", format: "esm", entryPoints: names.map((name) => `test/${name}`), outdir: resolve(tests), outExtension: { ".js": ".mjs" },
    banner: { js: "import { createRequire } from 'node:module'; const require = createRequire(import.meta.url);" } });
} else {
  const out = resolve(argument("--out") ?? join(HERE, "../koop_view/page/index.html"));
  mkdirSync(dirname(out), { recursive: true });
  const text = await page();
  writeFileSync(out, text);
  console.log(`${basename(out)}: ${Math.round(Buffer.byteLength(text) / 1000)} kB`);
}
