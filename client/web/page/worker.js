// Network, decoding and drawing, away from the page's thread. The page says what a person does; this says what to show.
import init, { Client } from "./gnomon_web.js";
import { NotOpened, open } from "./link.js";
import { areCompiled } from "./pipelines.js";

/** Most pixels of a picture, and of one that the processor draws. */
const MOST_PIXELS = 1920 * 1080;
const MOST_SOFTWARE_PIXELS = 640 * 360;

/** Pauses between attempts to find a lost server. */
const FIRST_PAUSE_MS = 250;
const LONGEST_PAUSE_MS = 8000;

/** A server answers one ping a second. */
const PING_MS = 1000;
const SILENT_MS = 4000;

/** A page that nobody sees for so long gives its place back, unless `unseen_ms` says otherwise. */
const UNSEEN_MS = 30_000;

/** Scenes that are kept. */
const KEPT_SCENES = 4;

const FIGURES_MS = 500;

let client = null;
let memory = null; // Of wasm.
let page = null; // What the page said first.
let size = [1, 1];
let link = null;
let largest = [0, 0]; // Of this session's masks.
let current = null; // How this session will have ended.
let started = false; // Poses go out.
let visible = true;
let unseen = null;
let wake = null; // Ends a pause.
let heardAt = 0;
let ping = { number: 0, at: 0 };
let trip = null;
let figuresAt = 0;
let said = ""; // The last state.
const marks = {};

const tell = (is, more = {}) => postMessage({ is, ...more });
const mark = (name) => (marks[name] ??= performance.timeOrigin + performance.now());

function state(name, more = {}) {
  const text = JSON.stringify([name, more]);
  if (text !== said) tell("state", { name, ...more });
  said = text;
}

/** A problem that trying again by itself does not mend. */
class Final extends Error {
  constructor(why, message) {
    super(message);
    this.why = why;
  }
}

function fitted([width, height]) {
  const most = client?.is_software() && !page.options.pixels ? MOST_SOFTWARE_PIXELS : (page.options.pixels ?? MOST_PIXELS);
  const share = Math.min(1, Math.sqrt(most / (width * height)));
  return [width, height].map((side) => Math.max(16, Math.round(side * share)));
}

async function begin(message) {
  page = message;
  size = page.size;
  mark("begun");
  const ready = init({ module_or_path: new URL("./gnomon_web_bg.wasm", import.meta.url) }).then((wasm) => {
    memory = wasm.memory;
    mark("compiled");
  });
  const answer = ask().catch((error) => error);
  await ready;
  if (!navigator.gpu) throw new Final("webgpu", "WebGPU is missing in workers");
  try {
    client = await Client.open(page.canvas, JSON.stringify(page.options));
  } catch (error) {
    throw new Final("webgpu", error.message ?? String(error));
  }
  mark("adapter");
  tell("opened", { software: client.is_software() });
  client.resize(...fitted(size));
  requestAnimationFrame(draw);
  setInterval(watch, PING_MS);
  await answer;
  await serve();
}

async function ask() {
  let answer;
  try {
    answer = await fetch(page.server, { cache: "no-store" });
  } catch (error) {
    throw new Error(`the server's address does not answer (${error.message})`);
  }
  if (!answer.ok) throw new Error(`${page.server} answers ${answer.status}`);
  const server = await answer.json();
  mark("asked");
  return server;
}

/** Keeps a session, for as long as the page is there. */
async function serve() {
  let failures = 0;
  for (;;) {
    while (unseen === "left") await pause(1 << 30);
    const end = await session();
    if (end.lasted) failures = 0;
    if (end.dismissed || end.code === 4) throw new Final("ended", end.reason || "the operator ended this session");
    if (end.again || unseen === "left") continue;
    const { refused } = end;
    if (refused && refused.retry_after_ms == null && refused.why !== "draining") {
      throw new Final(refused.why, refused.text);
    }
    const ms = refused?.retry_after_ms ?? Math.min(LONGEST_PAUSE_MS, FIRST_PAUSE_MS * 2 ** failures) * (0.75 + Math.random() / 2);
    failures += 1;
    state(refused ? "refused" : "lost", { text: refused?.text ?? end.reason, seconds: Math.ceil(ms / 1000), first: !started });
    await pause(ms);
  }
}

function pause(ms) {
  return new Promise((resolve) => {
    const timer = setTimeout(resolve, Math.min(ms, 2 ** 31 - 1));
    wake = () => {
      clearTimeout(timer);
      resolve();
    };
  });
}

/** Runs one session. Returns how it ended. */
async function session() {
  const end = { lasted: false, refused: null, again: false, dismissed: false, code: null, reason: "" };
  let server;
  try {
    server = await ask();
  } catch (error) {
    return { ...end, reason: error.message };
  }
  if (server.protocol_version !== Client.protocol_version()) {
    const versions = `The server speaks version ${server.protocol_version}, this page version ${Client.protocol_version()}.`;
    throw new Final("version", versions);
  }
  if (server.origins && !server.origins.includes(location.origin)) {
    throw new Final("origin", `It takes pages of ${server.origins.join(", ")}, and this one is of ${location.origin}.`);
  }
  if (!started) tell("stage", { text: `Connecting to ${server.scene}` });
  current = end;
  const closed = new Promise((resolve, reject) => Object.assign(end, { close: resolve, fail: reject }));
  const hear = {
    control: (bytes) => {
      heardAt = performance.now();
      try {
        client.control(bytes);
      } catch (error) {
        end.reason = error.message;
        link?.close();
        return;
      }
      listen(end).catch(end.fail);
    },
    datagram: (bytes) => {
      heardAt = performance.now();
      client.datagram(bytes);
      flush();
    },
    closed: ({ code, reason }) => end.close({ code, reason: end.reason || reason }),
  };
  try {
    link = await open(server, page.server, hear);
  } catch (error) {
    if (!(error instanceof NotOpened)) throw error;
    return { ...end, reason: error.message };
  }
  mark("connected");
  heardAt = performance.now();
  largest = fitted(size);
  client.resize(...largest);
  const [width, height] = largest;
  client.connect(JSON.stringify({ token: page.token, width, height, rate_hz: 60, codec: page.options.codec }));
  flush();
  try {
    const { code, reason } = await closed;
    return { ...end, code, reason: reason || "the connection is gone" };
  } finally {
    link.close();
    link = null;
    client.lost();
  }
}

/** Does what the server's messages ask for. */
async function listen(end) {
  for (let text; (text = client.event()); ) {
    const event = JSON.parse(text);
    switch (event.is) {
      case "welcome":
        mark("welcome");
        tell("welcome", event);
        await welcomed(event, end);
        break;
      case "fetching":
        tell("fetching", event);
        break;
      case "scene":
        mark("fetched");
        keep(end.digest, client.packed());
        await begun(end);
        break;
      case "refused":
        end.refused = event;
        break;
      case "draining":
        state("draining", { text: event.reason, seconds: Math.ceil(event.deadline_ms / 1000), elsewhere: event.elsewhere });
        break;
      case "closing":
        end.reason = event.reason;
        end.dismissed = !event.may_return;
        // A transport may take long to say that it has closed, and may lose the code.
        if (end.dismissed) end.close({ code: null, reason: event.reason });
        break;
      case "pong":
        if (event.number === ping.number) trip = performance.now() - ping.at;
        break;
    }
  }
  flush();
}

async function welcomed(event, end) {
  end.digest = event.digest;
  if (event.has_scene) {
    await begun(end);
    return;
  }
  const kept = await look(event.digest);
  if (kept && client.offer(kept)) {
    mark("found");
    await begun(end);
  } else {
    client.fetch();
    flush();
  }
}

/** Lets the browser do what was asked of it. */
const turn = () => new Promise((resolve) => setTimeout(resolve));

/** The scene is there. The first pose goes out before all is ready to draw: the server traces meanwhile. */
async function begun(end) {
  if (!link) return;
  const known = started;
  tell("stage", { text: "Preparing the scene" });
  try {
    let more = client.prepare();
    for (const step of ["unpacked", "uploaded"]) {
      if (!more) break;
      mark(step);
      await turn();
      more = client.prepare();
    }
    if (current !== end || !link) return;
    client.start();
    flush();
    mark("started");
    if (more) {
      await turn();
      if (current !== end || !link) return;
      client.prepare();
    }
  } catch (error) {
    throw new Final("scene", error.message);
  }
  mark("prepared");
  flush();
  [started, end.lasted] = [true, true];
  state("live", { again: known, way: link.kind, why: link.why });
}

async function store() {
  return caches.open("gnomon-scenes");
}

const keyOf = (digest) => new URL(`/scene/${digest}`, page.server).href;

/** Returns a scene that was kept. A browser that keeps nothing fetches it again. */
async function look(digest) {
  try {
    const found = await (await store()).match(keyOf(digest));
    return found && new Uint8Array(await found.arrayBuffer());
  } catch {
    return null;
  }
}

async function keep(digest, packed) {
  try {
    const kept = await store();
    for (const old of (await kept.keys()).slice(0, 1 - KEPT_SCENES)) await kept.delete(old);
    await kept.put(keyOf(digest), new Response(packed));
  } catch {
    // Full, or forbidden.
  }
}

function flush() {
  if (!link) return;
  const control = client.outgoing_control();
  if (control.length) link.control(control);
  for (let packet; (packet = client.outgoing_datagram()); ) link.datagram(packet);
}

/** Asks for a sign of life, and closes what gives none. */
function watch() {
  if (!link) return;
  const now = performance.now();
  if (visible && started && now - heardAt > SILENT_MS && now - ping.at < 3 * PING_MS) {
    state("lost", { text: "the server is silent", seconds: 0, first: false });
    link.close();
    return;
  }
  ping = { number: ping.number + 1, at: now };
  client.ping(ping.number);
  flush();
}

function draw(now) {
  requestAnimationFrame(draw);
  try {
    const news = areCompiled() && client.frame();
    if (news) heed(JSON.parse(news));
    flush();
    show(now);
  } catch (error) {
    fail(error instanceof Final ? error : new Final("device", error.message ?? String(error)));
  }
}

function heed({ drawn, shadowed, shown, share, walked }) {
  if (drawn) mark("drawn");
  if (shadowed) mark("shadowed");
  if (shown) mark("shown");
  if (drawn || shadowed || shown) tell("drawn", { marks });
  if (share) client.resize(...fitted(size));
  if (walked) {
    if (walked.arrived) client.end_walk();
    tell("walked", walked);
  }
}

function show(now) {
  const picture = client.take_picture();
  if (picture) encode(picture);
  if (now - figuresAt >= FIGURES_MS) {
    figuresAt = now;
    const figures = client.figures();
    if (figures) tell("figures", { ...JSON.parse(figures), trip, way: link?.kind, view: client.view(), wasm_bytes: memory.buffer.byteLength });
  }
}

async function encode(picture) {
  const words = new DataView(picture.buffer, picture.byteOffset);
  const [frame, width, height] = [0, 4, 8].map((at) => words.getUint32(at, true));
  const pixels = new ImageData(new Uint8ClampedArray(picture.subarray(12)), width, height);
  const canvas = new OffscreenCanvas(width, height);
  canvas.getContext("2d", { colorSpace: "srgb" }).putImageData(pixels, 0, 0);
  tell("picture", { frame, blob: await canvas.convertToBlob({ type: "image/png" }) });
}

function fail(error) {
  const why = error instanceof Final ? error.why : "broken";
  tell("failed", { why, text: error.message ?? String(error) });
  if (why === "device") close();
}

function see(now) {
  visible = now;
  clearTimeout(unseen);
  if (visible) {
    const left = unseen === "left";
    unseen = null;
    if (left) state("back");
    wake?.();
  } else {
    unseen = setTimeout(() => {
      unseen = "left";
      state("asleep");
      client?.leave();
      flush();
      setTimeout(() => link?.close(), 100);
    }, page?.options.unseen_ms ?? UNSEEN_MS);
  }
}

function follow(next) {
  size = next;
  if (!client) return;
  const wanted = fitted(size);
  const fits = wanted.every((side, at) => side <= largest[at]);
  if (fits || !link) client.resize(...wanted);
  else {
    // Larger masks than this session may have: another takes it over.
    current.again = true;
    client.leave();
    flush();
    link.close();
  }
}

const heard = {
  size: ({ size: next }) => follow(next),
  visible: ({ visible: now }) => see(now),
  again: () => wake?.(),
  drop: () => link?.close(),
  key: ({ code, down }) => client.key(code, down),
  drag: ({ down }) => client.drag(down),
  pointer: ({ x, y }) => client.pointer(x, y),
  wheel: ({ notches }) => client.wheel(notches),
  touch: ({ phase, id, x, y }) => (phase === "end" ? client.touch_end(id) : client[`touch_${phase}`](id, x, y)),
  sticks: ({ walk, look: turn, climb }) => client.sticks(...walk, ...turn, climb),
  letGo: () => client.let_go(),
  choose: ({ name, value }) => client.choose(name, value),
  path: () => client.toggle_path(),
  camera: () => client.next_camera(),
  go: ({ view }) => client.go(view),
  picture: () => client.save_picture(),
};

onmessage = ({ data }) => {
  if (data.is === "open") {
    begin(data).catch(fail);
  } else if (client || data.is === "size" || data.is === "visible") {
    try {
      heard[data.is]?.(data);
    } catch (error) {
      fail(error);
    }
  }
};
