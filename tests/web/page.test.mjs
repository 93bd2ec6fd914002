// The page in a real browser, on a real server.
import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { readFile, writeFile } from "node:fs/promises";
import { join } from "node:path";
import { after, test } from "node:test";
import { bin, browser, closeBrowsers, cloisterPaths, compare, folder, hide, native, open, screenshot, server, until } from "./rig.mjs";

after(closeBrowsers);

const FRAMES = Number(process.env.WEB_TEST_FRAMES ?? 20);
/** Compared with the native client's. */
const PICTURES = [0, FRAMES >> 1, FRAMES - 1];
/** Fixed, since eyes that adapt never see quite the same again. */
const EXPOSURE = 12;
const LEAST_PSNR_DB = 50;

/** Where pictures do not matter, they cost little. */
const SMALL = { size: [160, 90] };

/** Lies about what the server announces. */
const changed = (change) => async (route) => {
  try {
    const response = await route.fetch();
    await route.fulfill({ response, json: change(await response.json()) });
  } catch {
    // The server or the page is gone.
  }
};

/** A network that drops UDP: nobody answers at another port. */
const behind = changed((server) => ({ ...server, port: 9 }));

/** All that the page has said over the picture. */
const said = (page) => page.evaluate(() => gnomon.log.banners.join("\n"));

test("a walk in the browser has the native client's masks, bit for bit, and its pictures", async (t) => {
  const { page: url, url: nativeUrl } = await server(t);
  const out = await folder(t);
  const log = join(out, "masks.log");
  await native(nativeUrl, [
    "--wait", "--size", "640x360", "--frames", String(FRAMES), "--path", `${cloisterPaths}#walk`, "--exposure", String(EXPOSURE),
    "--out", out, "--mask-log", log, "--cache-dir", out,
  ]);
  const expected = new Map();
  for (const line of (await readFile(log, "utf8")).trim().split("\n")) {
    const [frame, , , , digest] = line.split(" ");
    expected.set(Number(frame), digest);
  }
  const started = await browser(t);
  const walk = { path: await readFile(cloisterPaths, "utf8"), name: "walk", frames: FRAMES, pictures: PICTURES };
  const page = await open(started, url, { options: { walk, exposure: EXPOSURE, size: [640, 360] } });
  await until(page, (arg) => gnomon.log.walked.at(-1)?.arrived && arg.every((frame) => gnomon.log.pictures[frame]), PICTURES, 300_000);
  const { walked, pictures, csp } = await page.evaluate(() => gnomon.log);
  assert.deepEqual(csp, []);
  assert.deepEqual(page.problems, []);
  assert.equal(walked.length, FRAMES);
  for (const { frame, digest } of walked) assert.equal(digest, expected.get(frame), `the mask of frame ${frame}`);
  for (const frame of PICTURES) {
    const file = await readFile(join(out, `frame_${String(frame).padStart(6, "0")}.png`));
    const { psnr, differ } = await compare(started, pictures[frame], `data:image/png;base64,${file.toString("base64")}`);
    t.diagnostic(`frame ${frame}: ${psnr.toFixed(1)} dB, ${(differ * 100).toFixed(2)} % of the channels differ`);
    assert.ok(psnr >= LEAST_PSNR_DB, `frame ${frame}: ${psnr} dB`);
  }
});

test("a person sees the scene on a desktop, and on a phone", async (t) => {
  const { page: url } = await server(t);
  const started = await browser(t);
  const page = await open(started, url);
  await until(page, () => gnomon.log.marks.shadowed && gnomon.figures().masks > 2);
  await page.click("#tool-figures");
  await page.click("#tool-split");
  await page.waitForTimeout(1500);
  await screenshot(page, "desktop");
  const shown = await page.evaluate(() => gnomon.figures());
  assert.ok(shown.frames_per_s > 0 && shown.known_share > 0.5, JSON.stringify(shown));
  // The keys walk.
  const { view: before } = shown;
  await page.keyboard.down("KeyW");
  await page.waitForFunction((view) => gnomon.figures().view !== view, before);
  await page.keyboard.up("KeyW");
  // The link leads there again.
  const { view } = await page.evaluate(() => gnomon.figures());
  await page.evaluate(() => {
    location.hash = "view=1,2,3,45,-10,60";
  });
  await page.waitForFunction(() => gnomon.figures().view === "1.000,2.000,3.000,45.00,-10.00,60.00");
  assert.notEqual(view, before);
  assert.deepEqual(await page.evaluate(() => gnomon.log.csp), []);
  assert.deepEqual(page.problems, []);
  await page.context().close();

  const phone = await open(started, url, { viewport: { width: 390, height: 844 }, phone: true });
  await until(phone, () => gnomon.log.marks.shadowed && gnomon.figures().masks > 2);
  await phone.waitForTimeout(1500);
  await screenshot(phone, "phone");
  const wide = await phone.evaluate(() => document.documentElement.scrollWidth <= innerWidth);
  assert.ok(wide, "nothing is cut off");
  assert.deepEqual(phone.problems, []);
});

test("a browser without WebGPU is told what would do, and a network without UDP is passed by WebSocket", async (t) => {
  const { page: url } = await server(t);
  const old = await browser(t, { webgpu: false });
  const page = await open(old, url);
  await until(page, () => gnomon.log.failed?.why === 'webgpu');
  await page.waitForSelector("#card:not([hidden])");
  await screenshot(page, "no-webgpu");
  assert.match(await page.textContent("#card"), /WebGPU.*Chrome.*Safari.*Firefox/s);
  const started = await browser(t);
  const blocked = await open(started, url, { options: SMALL, route: behind });
  await until(blocked, () => gnomon.log.marks.shadowed && gnomon.figures().way === 'WebSocket');
  assert.match(await said(blocked), /By WebSocket.*UDP/s);
  await screenshot(blocked, "websocket");
  assert.deepEqual(await blocked.evaluate(() => gnomon.log.csp), []);
});

/** Another server, as the one that drains names it. */
const ALTERNATIVE = `gnomon://b.example:1/?cert=${"0f".repeat(32)}`;

test("a server that drains, goes and comes back is announced, lost and found", async (t) => {
  const certificates = await folder(t);
  const first = await server(t, { certificates, args: ["--drain-ms", "300000", "--alternative", ALTERNATIVE] });
  const listen = first.url.match(/gnomon:\/\/([^/]+)\//)[1];
  const web = new URL(first.page).host;
  const started = await browser(t);
  const page = await open(started, first.page, { options: SMALL });
  await until(page, () => gnomon.log.marks.shadowed);
  first.child.kill("SIGTERM");
  await until(page, () => gnomon.log.states.includes('draining'));
  await screenshot(page, "draining");
  assert.match(await said(page), /ends this session in.* gnomon:\/\/b\.example:1\//);
  // A second one does not wait for the end of the drain.
  first.child.kill("SIGTERM");
  await until(page, () => gnomon.log.states.includes('lost'));
  await screenshot(page, "lost");
  assert.match(await said(page), /Connection lost/);
  await server(t, { certificates, listen, web });
  await until(page, () => gnomon.log.states.at(-1) === 'live' && gnomon.log.states.filter((name) => name === 'live').length === 2);
  await screenshot(page, "found");
  assert.match(await said(page), /Connected again/);
  const { masks } = await page.evaluate(() => gnomon.figures());
  await page.waitForFunction((before) => gnomon.figures().masks !== before, masks);
  assert.deepEqual(page.problems, []);
});

test("tokens, versions, origins and certificates that do not fit are said in words", async (t) => {
  const { page: url } = await server(t);
  const started = await browser(t);
  const old = await open(started, url, { route: changed((server) => ({ ...server, protocol_version: 5 })) });
  await until(old, () => gnomon.log.failed?.why === 'version');
  assert.match(await old.textContent("#card"), /The server speaks version 5, this page version \d+/);

  const wrong = { current: "00".repeat(32), next: "11".repeat(32) };
  const lie = (server) => ({ ...server, certificate_sha256: wrong, websocket: null });
  const pinned = await open(started, url, { route: changed(lie) });
  await until(pinned, () => gnomon.log.states.includes('lost'));
  assert.match(await pinned.textContent("#loading"), /UDP.*certificate/s);
  assert.equal(await pinned.evaluate(() => gnomon.log.welcome), undefined);

  const strict = await server(t, { args: ["--origins", "https://a.example"] });
  const stranger = await open(started, strict.page);
  await until(stranger, () => gnomon.log.failed?.why === 'origin');
  assert.match(await stranger.textContent("#card"), /https:\/\/a\.example/);

  const secrets = await folder(t);
  const tokens = join(secrets, "tokens.toml");
  const [alice, bob, carol] = ["alice", "bob", "carol"].map((name) => {
    const made = execFileSync(join(bin, "gnomon-server"), ["token", "--name", name, "--days", "1"], { encoding: "utf8" });
    const [secret, ...entry] = made.split("\n");
    return { secret, entry: entry.join("\n") };
  });
  await writeFile(tokens, [alice, bob, carol].map(({ entry }) => entry).join("\n"));
  const guarded = await server(t, { args: ["--token-file", tokens] });
  const without = await open(started, guarded.page);
  await until(without, () => gnomon.log.failed?.why === 'token');
  // A token that is withdrawn ends its session, and coming back is for the person to try. One after the other: a busy
  // machine has no place for two.
  for (const [{ secret }, left, way] of [[alice, [bob, carol]], [bob, [carol], behind]]) {
    const welcome = await open(started, `${guarded.page}#token=${secret}`, { options: SMALL, route: way });
    await until(welcome, () => gnomon.log.marks.shadowed);
    assert.ok(!welcome.url().includes(secret), "the token left the address bar");
    await writeFile(tokens, left.map(({ entry }) => entry).join("\n"));
    guarded.child.kill("SIGHUP");
    await until(welcome, () => gnomon.log.failed?.why === 'ended');
    assert.match(await welcome.textContent("#card"), /withdrawn/);
    await welcome.context().close();
  }
});

test("a page that is lost or unseen comes back, again and again", async (t) => {
  const { page: url } = await server(t);
  const page = await open(await browser(t), url, { options: { ...SMALL, unseen_ms: 100 } });
  await until(page, () => gnomon.log.marks.shadowed);
  const lives = (count) => until(page, (count) => gnomon.log.lives === count, count);
  for (let times = 2; times < 5; times += 1) {
    await page.evaluate(() => gnomon.ask({ is: "drop" }));
    await lives(times);
  }
  await hide(page, true);
  await until(page, () => gnomon.log.states.at(-1) === "asleep");
  await hide(page, false);
  await lives(5);
  const { masks } = await page.evaluate(() => gnomon.figures());
  await page.waitForFunction((before) => gnomon.figures().masks !== before, masks);
  assert.deepEqual(page.problems, []);
});
