// Prints the way to the first picture with shadows, in ms from opening the page.
// usage: node first-picture.mjs [RUNS]   (each run once with an empty cache and once with the scene kept)
import { launch, server } from "./rig.mjs";

const REST_MS = 3000;

const marks = ["begun", "compiled", "adapter", "connected", "fetched", "found", "unpacked", "uploaded", "started", "prepared", "shadowed", "shown"];

for (let at = 0; at < Number(process.argv[2] ?? 3); at += 1) {
  const ends = [];
  // A server of its own: one paces what an address fetches again and again.
  const { page: url } = await server({ after: (end) => ends.unshift(end) });
  const started = await launch();
  ends.unshift(() => started.close());
  try {
    const context = await started.newContext({ viewport: { width: 640, height: 360 } });
    for (const what of ["empty cache", "scene kept"]) {
      // What a page before it left to compile is not its own.
      await new Promise((rested) => setTimeout(rested, REST_MS));
      const page = await context.newPage();
      await page.goto(url);
      await page.waitForFunction(() => gnomon.log.marks.shown, null, { timeout: 120_000, polling: 20 });
      const found = await page.evaluate(() => ({ marks: gnomon.log.marks, origin: performance.timeOrigin }));
      const cell = (name) => (found.marks[name] ? Math.round(found.marks[name] - found.origin) : "–");
      console.log(`| ${what} | ${marks.map(cell).join(" | ")} |`);
      await new Promise((rested) => setTimeout(rested, REST_MS));
      await page.close();
    }
  } finally {
    for (const end of ends) await end();
  }
}
