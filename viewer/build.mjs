// Builds the page without an avatar: style and script of src/ in one file, ../pipeline/viewer/bundle/page.html.
// `node build.mjs FILE` writes another file, for the test that the committed one is what the sources build.
import { build } from "esbuild";
import { mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const out = process.argv[2] ?? join(here, "../pipeline/viewer/bundle/page.html");

async function bundled(entry, options = {}) {
  const made = await build({
    entryPoints: [join(here, "src", entry)],
    bundle: true,
    minify: true,
    write: false,
    charset: "utf8",
    legalComments: "none",
    target: ["chrome103", "firefox115", "safari16.4"],
    ...options,
  });
  return made.outputFiles[0].text.trim();
}

const style = await bundled("page.css");
const script = await bundled("main.js", { format: "iife" });
const page = readFileSync(join(here, "src/page.html"), "utf8")
  .replace("/* style */", () => style)
  .replace("/* script */", () => script.replaceAll("</script", "<\\/script"));
mkdirSync(dirname(out), { recursive: true });
writeFileSync(out, page);
console.log(`${out}: ${(page.length / 1000).toFixed(1)} kB`);
