// Prints how long wasm takes to decode masks, in the engine that Chromium has too. Natively, on one core:
//   taskset -c 0 cargo run --release -p gnomon-protocol --example codec_times FRAME.body …
// usage: taskset -c 0 node decode-times.mjs FRAME.body …   (as gnomon-client --codec CODEC --save-masks writes them)
import { readFile } from "node:fs/promises";
import { join, resolve } from "node:path";
import { fileURLToPath, pathToFileURL } from "node:url";

const root = resolve(fileURLToPath(import.meta.url), "../../..");
const page = process.env.WEB_TEST_PAGE ?? join(root, "target/web/page");
const { initSync, decode_ms: decode } = await import(pathToFileURL(join(page, "gnomon_web.js")));
initSync({ module: await readFile(join(page, "gnomon_web_bg.wasm")) });

const CODECS = ["words", "words-lz4", "planes-lz4", "tiles-small", "tiles-fast"];
const times = new Map();
const files = process.argv.slice(2);
for (let round = 0; round < 2; round += 1) {
  for (const file of files) {
    const body = await readFile(file);
    const median = decode(body, 100);
    // The first round warms the compiler up.
    if (round > 0) times.set(body[0], [...(times.get(body[0]) ?? []), median]);
  }
}
for (const [codec, found] of times) {
  found.sort((a, b) => a - b);
  const [least, middle, most] = [0, 0.5, 0.999].map((share) => found[Math.floor(found.length * share)].toFixed(3));
  console.log(`${CODECS[codec]}: ${middle} ms a mask (${least} to ${most}, ${found.length} masks)`);
}
