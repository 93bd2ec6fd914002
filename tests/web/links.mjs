// The page behind networks, beside the native client on the same path: a table. The last rows are by WebSocket, as where
// UDP is dropped altogether; TCP does not pass `lab link`, so they say what that costs on loopback.
// usage: node links.mjs [--profiles wifi,lte,bad] [--seconds 20] [--size 160x90]
//
// Wants lab beside gnomon-server and gnomon-client.
import { spawn } from "node:child_process";
import { createSocket } from "node:dgram";
import { readFile } from "node:fs/promises";
import { join } from "node:path";
import { parseArgs } from "node:util";
import { bin, cloisterPaths, folder, launch, native, open, server, until } from "./rig.mjs";

const text = (value) => ({ type: "string", default: value });
const { values } = parseArgs({ options: { profiles: text("wifi,lte,bad"), seconds: text("20"), size: text("160x90") } });
const size = values.size.split("x").map(Number);
const seconds = Number(values.seconds);

async function freePort() {
  const socket = createSocket("udp4");
  await new Promise((bound) => socket.bind(0, "127.0.0.1", bound));
  const { port } = socket.address();
  await new Promise((closed) => socket.close(closed));
  return port;
}

const middle = (numbers) => numbers.filter((number) => number != null).sort((a, b) => a - b)[numbers.length >> 1];

function row(name, client, { frames, lag, age, mbit, known, degraded }) {
  const cell = (value, digits) => (value == null ? "–" : value.toFixed(digits));
  console.log(
    `| ${name} | ${client} | ${cell(frames, 1)} | ${cell(lag, 0)} | ${cell(age, 0)} | ${cell(mbit, 2)} | ` +
      `${cell(known * 100, 2)} | ${cell(degraded * 100, 0)} |`,
  );
}

/** In the page: goes along a path as the native client does, a view at a time. */
function walk(keyframes) {
  const begun = performance.now();
  const length = keyframes.at(-1).t;
  const forward = ({ pos, target }) => {
    const away = target.map((to, axis) => to - pos[axis]);
    return away.map((part) => part / Math.hypot(...away));
  };
  setInterval(() => {
    const there = ((performance.now() - begun) / 1000) % (2 * length);
    const t = Math.min(there, 2 * length - there);
    const next = Math.max(1, keyframes.findIndex((keyframe) => keyframe.t >= t));
    const [from, to] = [keyframes[next - 1], keyframes[next]];
    const share = (t - from.t) / (to.t - from.t);
    const mix = (one, other) => one.map((part, axis) => part + (other[axis] - part) * share);
    const [x, y, z] = mix(forward(from), forward(to));
    const angles = [Math.atan2(-x, -z), Math.asin(y / Math.hypot(x, y, z))].map((angle) => (angle * 180) / Math.PI);
    gnomon.ask({ is: "go", view: [...mix(from.pos, to.pos), ...angles, 60].map((number) => number.toFixed(4)).join(",") });
  }, 15);
}

/** The page's figures while it goes along the path. */
async function page(started, url, route) {
  const opened = await open(started, url, { options: { size }, route });
  await until(opened, () => gnomon.log.marks.shown && gnomon.figures().masks > 2);
  await opened.evaluate(walk, JSON.parse(await readFile(cloisterPaths, "utf8")).camera_paths.walk.keyframes);
  const seen = [];
  for (let at = 0; at < seconds * 2; at += 1) {
    await opened.waitForTimeout(500);
    seen.push(await opened.evaluate(() => gnomon.figures()));
  }
  const states = seen.map(({ state }) => state);
  await opened.context().close();
  return {
    frames: middle(seen.map((figures) => figures.frames_per_s)),
    lag: middle(seen.map((figures) => figures.lag_frames)),
    age: middle(seen.map((figures) => figures.age_ms)),
    mbit: seen.reduce((sum, { mbit_per_s: mbit }) => sum + mbit, 0) / seen.length,
    known: middle(seen.map((figures) => figures.known_share)),
    degraded: states.filter((state) => state === "degraded").length / states.length,
  };
}

/** The native client's, at the page's rate. */
async function program(url, out, fps) {
  const stats = join(out, "stats.jsonl");
  const rate = Math.max(1, Math.round(fps));
  const frames = String(rate * seconds);
  const args = ["--size", values.size, "--frames", frames, "--fps", String(rate), "--path", `${cloisterPaths}#walk`];
  for (let tries = 0; ; tries += 1) {
    try {
      await native(url, [...args, "--stats", stats, "--cache-dir", out]);
      break;
    } catch (error) {
      // The page's session keeps its place for a while.
      if (tries === 4 || !error.message.includes("busy")) throw error;
      await new Promise((done) => setTimeout(done, 5000));
    }
  }
  const lines = (await readFile(stats, "utf8")).trim().split("\n").map((line) => JSON.parse(line));
  const masks = new Map(lines.filter(({ mask_frame: frame }) => frame != null).map((line) => [line.mask_frame, line.bytes]));
  const bytes = [...masks.values()].reduce((sum, count) => sum + count, 0);
  return {
    frames: (lines.length - 1) / ((lines.at(-1).t_ms - lines[0].t_ms) / 1000),
    lag: middle(lines.map(({ lag }) => lag)),
    age: middle(lines.map(({ age_ms: age }) => age)),
    mbit: (bytes * 8e-6) / seconds,
    known: middle(lines.map(({ known_share: known }) => known)),
    degraded: lines.filter(({ state }) => state === "degraded").length / lines.length,
  };
}

/** Starts a server behind a network. Without a name, on loopback. */
async function behind(run, profile) {
  const port = await freePort();
  const listen = ["--listen", `127.0.0.1:${port}`];
  if (!profile) return server(run, { listen: listen[1] });
  const outer = await freePort();
  const found = await server(run, { listen: listen[1], args: ["--advertise", `127.0.0.1:${outer}`] });
  const link = spawn(join(bin, "lab"), ["link", "--listen", `127.0.0.1:${outer}`, "--server", `127.0.0.1:${port}`, "--profile", profile], { stdio: ["ignore", "pipe", "pipe"] });
  run.after(() => link.kill());
  await new Promise((ready) => link.stdout.once("data", ready));
  return found;
}

console.log("| network | client | frames/s | lag, frames | age, ms | Mbit/s | known, % | degraded, % |");
console.log("|---|---|---:|---:|---:|---:|---:|---:|");
for (const profile of [...values.profiles.split(","), null]) {
  const ends = [];
  const run = { after: (end) => ends.unshift(end) };
  try {
    const found = await behind(run, profile);
    const started = await launch();
    run.after(() => started.close());
    const name = profile ?? "loopback";
    // Another port, where nobody answers.
    const dropped = async (route) => {
      const response = await route.fetch();
      await route.fulfill({ response, json: { ...(await response.json()), port: 9 } });
    };
    const figures = await page(started, found.page, profile ? undefined : dropped);
    row(profile ? name : "UDP dropped", profile ? "page" : "page, WebSocket", figures);
    await started.close();
    row(name, "native", await program(found.url, await folder(run), figures.frames));
  } finally {
    for (const end of ends) await end();
  }
}
