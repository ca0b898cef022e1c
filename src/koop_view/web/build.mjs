// Makes the pages of koop_view, each in one file: the operator's page and the frame of a report.
//
//   node build.mjs                  writes them to ../koop_view/page
//   node build.mjs --out FOLDER     writes them to another folder
//   node build.mjs --tests FOLDER   bundles the tests into FOLDER, for `node --test`

import { createHash } from "node:crypto";
import { mkdirSync, readdirSync, readFileSync, writeFileSync } from "node:fs";
import { dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";

const HERE = dirname(fileURLToPath(import.meta.url));
const COMMON = { bundle: true, target: "es2022", absWorkingDir: HERE, logLevel: "warning" };
const UPLOT = "node_modules/uplot/dist/uPlot.min.css";
const PAGES = [
  { out: "index.html", frame: "page.html", script: "main.ts", styles: ["report.css", "page.css"] },
  { out: "report.html", frame: "report.html", script: "report.ts", styles: ["report.css"] },
];

const read = (...path) => readFileSync(join(HERE, ...path), "utf8");

// What the pages are made of. The test that needs no Node.js computes the same.
function hashSources() {
  const sources = readdirSync(join(HERE, "src")).map((name) => `src/${name}`);
  const hash = createHash("sha256");
  for (const name of ["build.mjs", "package-lock.json", ...sources].sort()) {
    hash.update(`${name}\n`).update(read(name));
  }
  return hash.digest("hex");
}

// The licences of what is bundled, each text once.
function licences(inputs) {
  const names = inputs.map((path) => /node_modules\/((?:@[^/]+\/)?[^/]+)\//.exec(path)?.[1]);
  const texts = new Map();
  for (const name of [...new Set(names.filter(Boolean))].sort()) {
    const { version, license, author } = JSON.parse(read("node_modules", name, "package.json"));
    const files = readdirSync(join(HERE, "node_modules", name));
    const file = files.find((entry) => /^licen[cs]e/i.test(entry));
    const text = file
      ? read("node_modules", name, file).trim()
      : `${license} license, ${author?.name ?? author}; the package has no text of its own.`;
    texts.set(text, [...(texts.get(text) ?? []), `${name} ${version}`]);
  }
  const parts = [...texts].map(([text, packages]) => `${packages.join(", ")}:\n\n${text}`);
  return parts.join("\n\n----\n\n").replaceAll("*/", "* /");
}

async function makePage({ frame, script, styles }) {
  const bundle = await build({
    ...COMMON,
    entryPoints: [`src/${script}`],
    format: "iife",
    minify: true,
    write: false,
    metafile: true,
    charset: "utf8",
    legalComments: "none",
  });
  const sheets = [read(UPLOT), ...styles.map((name) => read("src", name))];
  const style = await build({
    ...COMMON,
    minify: true,
    write: false,
    stdin: { contents: sheets.join("\n"), loader: "css" },
  });
  const notice = licences(Object.keys(bundle.metafile.inputs));
  const code =
    `/*\nIn this page, beside its own code (Apache-2.0):\n\n${notice}\n*/\n` +
    `${bundle.outputFiles[0].text.trim()}\n`;
  if (/<\/script|<!--/i.test(code)) throw new Error("the script would end before its end");
  return read("src", frame)
    .replace("HASH", hashSources())
    .replace("/*STYLE*/", () => style.outputFiles[0].text.trim())
    .replace("/*SCRIPT*/", () => `\n${code}`);
}

async function bundleTests(folder) {
  const names = readdirSync(join(HERE, "test")).filter((name) => name.endsWith(".test.ts"));
  const require = "const require = createRequire(import.meta.url);";
  await build({
    ...COMMON,
    platform: "node",
    format: "esm",
    entryPoints: names.map((name) => `test/${name}`),
    outdir: resolve(folder),
    outExtension: { ".js": ".mjs" },
    banner: { js: `import { createRequire } from 'node:module'; ${require}` },
  });
}

const [option, folder] = process.argv.slice(2);
if (option === "--tests") {
  await bundleTests(folder);
} else {
  const out = option === "--out" ? resolve(folder) : join(HERE, "../koop_view/page");
  mkdirSync(out, { recursive: true });
  for (const page of PAGES) writeFileSync(join(out, page.out), await makePage(page));
}
