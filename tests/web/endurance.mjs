// How a page lasts: reconnects, a frozen tab, days. Prints a table.
// usage: node endurance.mjs [--reconnects 200] [--frozen-s 60] [--days 6.5]
//
// The tab is hidden as by another in front, gives its place back after 30 s, and is then frozen by Chromium's own page
// lifecycle, in which no timer runs: what an hour adds to that is time on the clocks. The server's clock is so many days
// behind the browser's until it is set right in one step, by libfaketime; its certificate is then to be renewed.
import { parseArgs } from "node:util";
import { readdirSync, readFileSync } from "node:fs";
import { clock, folder, hide, launch, open, server, until } from "./rig.mjs";

const options = { reconnects: { type: "string", default: "200" }, "frozen-s": { type: "string", default: "60" }, days: { type: "string", default: "6.5" } };
const { values } = parseArgs({ options });
const ends = [];
const run = { after: (end) => ends.unshift(end) };
const MIB = 1 << 20;

/** Memory of the tab's process that no other one shares, in MiB. */
function tabMib() {
  let most = 0;
  for (const id of readdirSync("/proc").filter((name) => /^\d+$/.test(name))) {
    try {
      const command = readFileSync(`/proc/${id}/cmdline`, "utf8");
      if (!command.includes("--type=renderer") || command.includes("--extension-process")) continue;
      const rollup = readFileSync(`/proc/${id}/smaps_rollup`, "utf8");
      const kib = [...rollup.matchAll(/^Private_\w+:\s+(\d+) kB/gm)].reduce((sum, [, part]) => sum + Number(part), 0);
      most = Math.max(most, kib / 1024);
    } catch {
      // It has ended.
    }
  }
  return most;
}

async function state(page) {
  const devtools = await page.context().newCDPSession(page);
  await devtools.send("HeapProfiler.collectGarbage");
  const { usedSize } = await devtools.send("Runtime.getHeapUsage");
  await devtools.detach();
  const { wasm_bytes: wasm, way } = await page.evaluate(() => gnomon.figures());
  return `tab ${tabMib().toFixed(0)} MiB, page's heap ${(usedSize / MIB).toFixed(1)}, wasm ${(wasm / MIB).toFixed(1)}, ${way}`;
}

const lives = (page, count) => until(page, (count) => gnomon.log.lives >= count, count);

async function live(page, count) {
  await lives(page, count);
  const { masks } = await page.evaluate(() => gnomon.figures());
  await page.waitForFunction((before) => gnomon.figures().masks !== before, masks);
}

try {
  const time = await clock(run, `-${values.days}d`);
  const certificates = await folder(run);
  const served = await server(run, { certificates, env: time.env });
  const started = await launch();
  run.after(() => started.close());
  const page = await open(started, served.page, { options: { size: [160, 90] } });
  await until(page, () => gnomon.log.marks.shown);
  await live(page, 1);
  console.log(`begun: ${await state(page)}`);
  let count = 1;
  const every = Math.max(1, Math.floor(Number(values.reconnects) / 4));
  for (let times = 1; times <= Number(values.reconnects); times += 1) {
    await page.evaluate(() => gnomon.ask({ is: "drop" }));
    await lives(page, (count += 1));
    if (times % every === 0) {
      await live(page, count);
      console.log(`${times} reconnects: ${await state(page)}`);
    }
  }
  await hide(page, true);
  await until(page, () => gnomon.log.states.at(-1) === "asleep");
  const devtools = await page.context().newCDPSession(page);
  await devtools.send("Page.setWebLifecycleState", { state: "frozen" });
  await new Promise((done) => setTimeout(done, Number(values["frozen-s"]) * 1000));
  await devtools.send("Page.setWebLifecycleState", { state: "active" });
  await hide(page, false);
  await live(page, (count += 1));
  console.log(`hidden for 30 s, frozen for ${values["frozen-s"]} s, and back: ${await state(page)}`);
  const shown = () => page.evaluate(async () => (await (await fetch("gnomon.json")).json()).certificate_sha256.current);
  const before = await shown();
  await time.set("+0d");
  // The server looks at its certificates once in a while; the page asks for their hashes whenever it connects.
  for (let tries = 0; tries < 60 && (await shown()) === before; tries += 1) await page.waitForTimeout(1000);
  await page.evaluate(() => gnomon.ask({ is: "drop" }));
  await live(page, (count += 1));
  const changed = before !== (await shown());
  console.log(`${values.days} days later, with ${changed ? "another" : "the same"} certificate: ${await state(page)}`);
  console.log(`problems: ${page.problems.join("; ") || "none"}`);
} finally {
  for (const end of ends) await end();
}
