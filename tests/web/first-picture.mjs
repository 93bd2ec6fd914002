// Prints the way to the first picture with shadows, in ms from opening the page.
// usage: node first-picture.mjs [RUNS]   (each run once with an empty cache and once with the scene kept)
import { launch, server } from "./rig.mjs";

const ends = [];
const run = { after: (end) => ends.unshift(end) };

const marks = ["begun", "compiled", "adapter", "connected", "fetched", "found", "unpacked", "uploaded", "prepared", "shadowed", "shown"];

try {
  const { page: url } = await server(run);
  console.log(`| | ${marks.join(" | ")} |`);
  console.log(`|---|${marks.map(() => "---:|").join("")}`);
  for (let at = 0; at < Number(process.argv[2] ?? 3); at += 1) {
    const started = await launch();
    try {
      const context = await started.newContext({ viewport: { width: 640, height: 360 } });
      for (const what of ["empty cache", "scene kept"]) {
        const page = await context.newPage();
        await page.goto(url);
        await page.waitForFunction(() => gnomon.log.marks.shown, null, { timeout: 120_000, polling: 20 });
        const found = await page.evaluate(() => ({ marks: gnomon.log.marks, origin: performance.timeOrigin }));
        const cell = (name) => (found.marks[name] ? Math.round(found.marks[name] - found.origin) : "–");
        console.log(`| ${what} | ${marks.map(cell).join(" | ")} |`);
        await page.close();
      }
    } finally {
      await started.close();
    }
  }
} finally {
  for (const end of ends) await end();
}
