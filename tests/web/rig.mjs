// A server, a browser, and the page between them.
//
// WEB_TEST_BIN is the folder of gnomon-server and gnomon-client, WEB_TEST_PAGE the built page, CHROMIUM the browser; the
// defaults are what `cargo test`, `make web` and Debian's package leave. Screenshots go to target/web/screenshots.
import { spawn } from "node:child_process";
import { existsSync } from "node:fs";
import { mkdir, mkdtemp, rename, rm, writeFile } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { fileURLToPath } from "node:url";
import { chromium } from "playwright-core";

const root = resolve(fileURLToPath(import.meta.url), "../../..");
export const bin = process.env.WEB_TEST_BIN ?? join(root, "target/debug");
const pageFolder = process.env.WEB_TEST_PAGE ?? join(root, "target/web/page");
export const screenshots = process.env.WEB_TEST_SCREENSHOTS ?? join(root, "target/web/screenshots");
export const cloister = join(root, "tests/assets/cloister.glb");
export const cloisterPaths = join(root, "tests/assets/cloister.json");

/** Software WebGPU: SwiftShader's Vulkan, which shows OffscreenCanvas in screenshots too. */
const SOFTWARE_WEBGPU = [
  "--enable-unsafe-webgpu",
  "--enable-features=Vulkan",
  "--use-vulkan=swiftshader",
  "--use-angle=swiftshader",
];

const QUIET = ["--no-sandbox", "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync"];

export async function folder(test) {
  const made = await mkdtemp(join(tmpdir(), "gnomon-web-"));
  test.after(() => rm(made, { recursive: true, force: true }));
  return made;
}

/** Starts a server with the page, and waits until it listens. Ends with the test. */
export async function server(test, { args = [], env = {}, listen = "127.0.0.1:0", web = "127.0.0.1:0", certificates } = {}) {
  const all = ["--scene", cloister, "--listen", listen, "--web", web, "--web-root", pageFolder, "--backend", "cpu", "--log", "json"];
  all.push("--cert-dir", certificates ?? (await folder(test)), ...args);
  const child = spawn(join(bin, "gnomon-server"), all, { env: { ...process.env, ...env }, stdio: ["ignore", "pipe", "pipe"] });
  const found = { child, log: "" };
  const ended = new Promise((done) => child.once("exit", done));
  found.stop = async (signal = "SIGTERM") => {
    child.kill(signal);
    await ended;
  };
  test.after(() => found.stop("SIGKILL"));
  await new Promise((ready, failed) => {
    child.once("exit", () => failed(new Error(`the server ended:\n${found.log}`)));
    const heard = () => {
      const web = found.log.match(/"message":"web address","local_addr":"([^"]+)"/)?.[1];
      found.page = web && `http://${web}/`;
      if (found.page && found.url) ready();
    };
    child.stderr.on("data", (text) => {
      found.log += text;
      heard();
    });
    child.stdout.on("data", (text) => {
      found.url ??= String(text).split("\n")[0];
      heard();
    });
  });
  return found;
}

/** Runs the native client to its end. */
export async function native(url, args) {
  const child = spawn(join(bin, "gnomon-client"), [url, "--headless", "--allow-software", ...args], {
    env: { ...process.env, XDG_RUNTIME_DIR: process.env.XDG_RUNTIME_DIR ?? tmpdir() },
    stdio: ["ignore", "ignore", "pipe"],
  });
  let log = "";
  child.stderr.on("data", (text) => {
    log += text;
  });
  const code = await new Promise((done) => child.once("exit", done));
  if (code !== 0) throw new Error(`gnomon-client ended with ${code}:\n${log}`);
}

/** Starts Chromium, without WebGPU if `webgpu` is false. */
export function launch({ webgpu = true, env = {} } = {}) {
  const executablePath = process.env.CHROMIUM ?? "/usr/bin/chromium";
  const args = [...QUIET, ...(webgpu ? SOFTWARE_WEBGPU : [])];
  return chromium.launch({ executablePath, headless: true, args, env: { ...process.env, ...env } });
}

const shared = new Map();

/** Returns a browser that the tests of a file share, until `closeBrowsers`. Its pages end with the test: they would go on drawing. */
export async function browser(test, { webgpu = true } = {}) {
  if (!shared.has(webgpu)) shared.set(webgpu, launch({ webgpu }));
  const started = await shared.get(webgpu);
  test.after(() => Promise.all(started.contexts().map((context) => context.close())));
  return started;
}

/** To be called at the end of such a file. */
export async function closeBrowsers() {
  for (const started of shared.values()) await (await started).close();
}

/** Hides the page, or shows it again, as another tab in front would. */
export async function hide(page, hidden) {
  await page.evaluate((hidden) => {
    Object.defineProperty(document, "hidden", { configurable: true, get: () => hidden });
    document.dispatchEvent(new Event("visibilitychange"));
  }, hidden);
}

/** A clock that a program with this environment reads, and that a test sets: `set("+6.5d")`. */
export async function clock(test, time) {
  const library = ["x86_64", "aarch64"]
    .map((machine) => `/usr/lib/${machine}-linux-gnu/faketime/libfaketimeMT.so.1`)
    .find((path) => existsSync(path));
  if (!library) throw new Error("libfaketime is not installed: run deploy/setup tests");
  const path = join(await folder(test), "clock");
  const set = async (time) => {
    await writeFile(`${path}.new`, time);
    await rename(`${path}.new`, path);
  };
  await set(time);
  const env = {
    LD_PRELOAD: library,
    FAKETIME_TIMESTAMP_FILE: path,
    FAKETIME_DONT_FAKE_MONOTONIC: "1",
    FAKETIME_NO_CACHE: "1",
  };
  return { env, set };
}

/** Opens the page. `options` is what a page around it may choose. Errors in the page fail the test. */
export async function open(started, url, { options = {}, viewport = { width: 960, height: 540 }, phone = false, route } = {}) {
  const context = await started.newContext({ viewport, hasTouch: phone, isMobile: phone, deviceScaleFactor: phone ? 2 : 1 });
  const page = await context.newPage();
  // Software draws a picture in a second, or in ten beside other work.
  page.setDefaultTimeout(180_000);
  page.problems = [];
  page.on("pageerror", (error) => page.problems.push(error.message));
  page.on("console", (message) => {
    // A server that is gone is said in the page.
    if (message.type() === "error" && !/Failed to load resource|ERR_/.test(message.text())) page.problems.push(message.text());
  });
  await page.addInitScript((chosen) => {
    globalThis.gnomonOptions = chosen;
  }, options);
  if (route) await page.route("**/gnomon.json", route);
  await page.goto(url);
  return page;
}

/** Waits until a condition over `gnomon.log` holds in the page. A function, since the page's policy runs no texts. */
export async function until(page, condition, arg, ms = 180_000) {
  try {
    await page.waitForFunction(condition, arg, { timeout: ms, polling: 50 });
  } catch (error) {
    const log = await page.evaluate(() => JSON.stringify({ ...gnomon.log, pictures: Object.keys(gnomon.log.pictures) }));
    throw new Error(`${condition} does not come: ${log} ${page.problems.join("\n")}\n${error.message}`);
  }
}

export async function screenshot(page, name) {
  await mkdir(screenshots, { recursive: true });
  await page.screenshot({ path: join(screenshots, `${name}.png`) });
}

/** Returns the PSNR of two PNG files in dB, and their share of different channels. */
export async function compare(started, one, other) {
  const page = await started.newPage();
  const result = await page.evaluate(async (urls) => {
    const [a, b] = await Promise.all(urls.map(async (url) => {
      const image = new Image();
      image.src = url;
      await image.decode();
      const canvas = new OffscreenCanvas(image.width, image.height);
      const context = canvas.getContext("2d");
      context.drawImage(image, 0, 0);
      return context.getImageData(0, 0, image.width, image.height);
    }));
    if (a.width !== b.width || a.height !== b.height) return { error: `${a.width}×${a.height} and ${b.width}×${b.height}` };
    let [sum, differ, count] = [0, 0, 0];
    for (let at = 0; at < a.data.length; at += 1) {
      if (at % 4 === 3) continue;
      const away = a.data[at] - b.data[at];
      sum += away * away;
      differ += away !== 0;
      count += 1;
    }
    return { psnr: sum === 0 ? Infinity : 10 * Math.log10((255 * 255 * count) / sum), differ: differ / count };
  }, [one, other]);
  await page.close();
  if (result.error) throw new Error(`pictures of different sizes: ${result.error}`);
  return result;
}
