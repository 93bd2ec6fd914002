// What a person sees and does. The worker has the rest.

const by = (id) => document.getElementById(id);
const canvas = by("picture");

/** What a page around this one, or a test, may set before this script runs. */
const options = { ...globalThis.gnomonOptions };

/** More than this only costs time on a screen that is held in a hand. */
const MOST_PIXEL_RATIO = 2;

/** A thumb's way to full speed, in CSS pixels. */
const STICK_PX = 50;

/** The left part of the screen walks, the rest looks. */
const WALK_PART = 0.4;

const TRY = [
  "Chrome or Edge 113 or later on Windows, macOS and ChromeOS, 121 on Android, 144 on Linux",
  "Safari 26.4 or later",
  "Firefox 141 or later on Windows, 145 on Apple silicon",
];

/** The problems that trying again does not mend, in words. */
const PROBLEMS = {
  webgpu: { title: "This browser cannot draw the scene", text: "It has no WebGPU, or no graphics adapter for it. These have:", list: TRY },
  insecure: { title: "Open this page over https", text: "Browsers draw and connect only for pages that came over https, or from this machine itself." },
  version: { title: "The server speaks another version", text: "Reload this page. If that does not help, the operator has to update the server." },
  origin: { title: "The server does not take sessions from this page", text: "Its operator lists the pages that may connect." },
  token: { title: "This server wants a token", text: "Open the link that its operator gave you: it ends in #token=…", again: true },
  unsupported: { title: "The server cannot serve this", again: true },
  ended: { title: "The operator ended this session", again: true },
  scene: { title: "The scene cannot be shown" },
  device: { title: "The graphics adapter failed", again: true },
  broken: { title: "Something went wrong", again: true },
};

let worker = null;
let last = {}; // The newest figures.
let bannerTimer = null;
let serving = false;
/** For tests, and for who asks what has happened. */
const log = { states: [], lives: 0, banners: [], walked: [], pictures: {}, marks: {}, failed: null, csp: [] };
globalThis.gnomon = { log, ask: (message) => worker.postMessage(message), figures: () => last };

addEventListener("securitypolicyviolation", ({ violatedDirective, blockedURI }) => note(log.csp, `${violatedDirective} ${blockedURI}`));

/** Of what happens again and again, the newest. */
function note(list, entry) {
  list.push(entry);
  if (list.length > 100) list.shift();
}

function show(element, visible) {
  by(element).hidden = !visible;
}

function problem(why, detail) {
  const { title, text = "", list = [], again = false } = PROBLEMS[why] ?? PROBLEMS.broken;
  log.failed = { why, detail };
  by("card-title").textContent = title;
  by("card-text").textContent = text;
  by("card-list").replaceChildren(...list.map((line) => Object.assign(document.createElement("li"), { textContent: line })));
  show("card-list", list.length > 0);
  by("card-detail").textContent = detail ?? "";
  show("card-detail", Boolean(detail));
  show("card-button", again);
  show("loading", false);
  show("tools", false);
  show("banner", false);
  show("card", true);
}

function banner(text, { good = false, ms = 0 } = {}) {
  clearTimeout(bannerTimer);
  if (text) note(log.banners, text);
  by("banner").textContent = text;
  by("banner").classList.toggle("good", good);
  show("banner", text !== "");
  if (ms) bannerTimer = setTimeout(() => show("banner", false), ms);
}

function loading(text, share) {
  by("loading-text").textContent = text;
  if (share === undefined) by("loading-bar").removeAttribute("value");
  else by("loading-bar").value = share;
}

const MB = 1e6;
const seconds = (count) => (count >= 1 ? ` Trying again in ${count} s.` : " Trying again.");

const heard = {
  stage: ({ text }) => loading(text),
  opened: ({ software }) => {
    loading("Connecting");
    log.software = software;
  },
  welcome: (event) => {
    log.welcome = event;
    loading("The scene");
  },
  fetching: ({ have, length }) => {
    const text = `The scene: ${(have / MB).toFixed(1)} of ${(length / MB).toFixed(1)} MB`;
    loading(text, have / length);
    if (serving) banner(text);
  },
  drawn: ({ marks }) => {
    Object.assign(log.marks, marks);
    serving = true;
    show("loading", false);
    show("tools", true);
  },
  state: (state) => {
    note(log.states, state.name);
    log.lives += state.name === "live";
    const { name, text, seconds: left, again, why, elsewhere } = state;
    const other = elsewhere ? ` For programs it names ${elsewhere}.` : "";
    if (name === "live" && why && !again) banner(`By WebSocket. ${why}.`, { ms: 8000 });
    else if (name === "live") banner(again ? "Connected again" : "", { good: true, ms: 5000 });
    else if (name === "draining") banner(`The server ends this session in ${left} s: ${text}. The picture goes on.${other}`);
    else if (name === "lost" && !serving) loading(`The server cannot be reached: ${text}.${seconds(left)}`);
    else if (name === "lost") banner(`Connection lost: ${text}.${seconds(left)} Until then without its shadows.`);
    else if (name === "refused" && !serving) loading(`${text}.${seconds(left)}`);
    else if (name === "refused") banner(`Refused: ${text}.${seconds(left)}`);
    else banner("");
  },
  figures,
  walked: (step) => log.walked.push(step),
  picture: async ({ frame, blob }) => {
    log.pictures[frame] = await new Promise((resolve) => {
      const reader = new FileReader();
      reader.onload = () => resolve(reader.result);
      reader.readAsDataURL(blob);
    });
    if (frame === 0 && !options.walk) download(blob);
  },
  failed: ({ why, text }) => problem(why, text),
};

function figures(shown) {
  last = shown;
  if (by("panel").hidden) return;
  const number = (value, digits, unit) => (value == null ? "–" : `${value.toFixed(digits)}${unit}`);
  by("figure-rate").textContent = number(shown.frames_per_s, 0, "");
  by("figure-lag").textContent = `${number(shown.lag_frames, 1, "")} frames`;
  by("figure-mbit").textContent = number(shown.mbit_per_s, 2, " Mbit/s");
  by("figure-known").textContent = number(shown.known_share == null ? null : shown.known_share * 100, 1, " %");
  by("figure-trip").textContent = number(shown.trip, 0, " ms");
  by("figure-way").textContent = shown.way ?? "lost";
  by("figure-size").textContent = `${shown.size[0]}×${shown.size[1]}${log.software ? ", by the processor" : ""}`;
}

function download(blob) {
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: "gnomon.png" });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

/** The token stays out of the address bar, of links that are shared, and of the history. */
function secrets() {
  const given = new URLSearchParams(location.hash.slice(1));
  const token = given.get("token") ?? sessionStorage.getItem("gnomon-token");
  if (given.has("token")) {
    sessionStorage.setItem("gnomon-token", token);
    given.delete("token");
    history.replaceState(null, "", `${location.pathname}${location.search}${given.size ? `#${given}` : ""}`);
  }
  return { token, view: given.get("view") ?? undefined };
}

function pixels() {
  const ratio = Math.min(devicePixelRatio, MOST_PIXEL_RATIO);
  return [canvas.clientWidth, canvas.clientHeight].map((side) => Math.max(16, Math.round(side * ratio)));
}

function start() {
  if (!isSecureContext) return problem("insecure");
  if (!navigator.gpu) return problem("webgpu");
  // The browser's process for graphics takes as long to start as the page to load.
  navigator.gpu.requestAdapter().catch(() => {});
  if (!canvas.transferControlToOffscreen) return problem("webgpu", "no OffscreenCanvas");
  worker = new Worker(new URL("./worker.js", import.meta.url), { type: "module" });
  worker.onmessage = ({ data }) => heard[data.is]?.(data);
  worker.onerror = ({ message }) => problem("broken", message);
  const { token, view } = secrets();
  const surface = canvas.transferControlToOffscreen();
  const server = new URL("gnomon.json", document.baseURI).href;
  const size = options.size ?? pixels();
  const message = { is: "open", canvas: surface, server, token, size, options: { view, ...options } };
  worker.postMessage(message, [surface]);
  new ResizeObserver(() => options.size || worker.postMessage({ is: "size", size: pixels() })).observe(canvas);
  document.addEventListener("visibilitychange", () => worker.postMessage({ is: "visible", visible: !document.hidden }));
  addEventListener("online", () => worker.postMessage({ is: "again" }));
  addEventListener("hashchange", () => {
    const { view } = secrets();
    if (view) worker.postMessage({ is: "go", view });
  });
  listen();
}

const say = (is, more = {}) => worker.postMessage({ is, ...more });

/** A letter's key, where no word is written and nothing is chosen. */
const COMMANDS = {
  n: () => say("path"),
  c: () => say("camera"),
  o: () => toggle("panel", "tool-figures"),
  h: () => toggle("help", "tool-help"),
  "?": () => toggle("help", "tool-help"),
  b: split,
  p: () => say("picture"),
  f: fullScreen,
  v: () => {
    const views = by("choice-view");
    views.selectedIndex = (views.selectedIndex + 1) % views.length;
    say("choose", { name: "view", value: views.value });
  },
};

function toggle(panel, button) {
  show(panel, by(panel).hidden);
  by(button).setAttribute("aria-expanded", String(!by(panel).hidden));
  if (!by(panel).hidden && last.size) figures(last);
}

function split() {
  const on = by("tool-split").getAttribute("aria-pressed") !== "true";
  by("tool-split").setAttribute("aria-pressed", String(on));
  say("choose", { name: "split", value: on ? "on" : "off" });
}

function fullScreen() {
  if (document.fullscreenElement) document.exitFullscreen();
  else document.documentElement.requestFullscreen?.().catch(() => banner("This browser has no full screen", { ms: 3000 }));
}

async function share() {
  const url = `${location.origin}${location.pathname}#view=${last.view ?? ""}`;
  try {
    await navigator.clipboard.writeText(url);
    banner("The link to this view is in the clipboard", { good: true, ms: 3000 });
  } catch {
    history.replaceState(null, "", url);
    banner("The address bar has the link to this view", { good: true, ms: 3000 });
  }
}

function listen() {
  keys();
  pointer();
  touch();
  if (navigator.getGamepads) requestAnimationFrame(gamepads);
  by("tool-figures").onclick = COMMANDS.o;
  by("tool-help").onclick = COMMANDS.h;
  by("tool-split").onclick = split;
  by("tool-share").onclick = share;
  by("tool-picture").onclick = COMMANDS.p;
  by("tool-full").onclick = fullScreen;
  by("card-button").onclick = () => location.reload();
  for (const name of ["predictor", "view", "quality"]) {
    by(`choice-${name}`).onchange = ({ target }) => say("choose", { name, value: target.value });
  }
}

function keys() {
  const chooses = (target) => target instanceof HTMLSelectElement || target instanceof HTMLInputElement;
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || chooses(event.target)) return;
    const command = COMMANDS[event.key.toLowerCase()];
    if (command && !event.repeat) command();
    else if (!event.repeat) say("key", { code: event.code, down: true });
    if (event.code.startsWith("Arrow") || event.code.startsWith("Page")) event.preventDefault();
  });
  addEventListener("keyup", (event) => say("key", { code: event.code, down: false }));
  addEventListener("blur", () => say("letGo"));
}

function pointer() {
  let at = [0, 0];
  canvas.addEventListener("pointerdown", (event) => {
    if (event.pointerType === "touch") return;
    canvas.focus({ preventScroll: true });
    at = [event.clientX, event.clientY];
    say("pointer", { x: at[0], y: at[1] });
    say("drag", { down: true });
    if (event.detail === 2 || event.button === 2) canvas.requestPointerLock?.();
    else canvas.setPointerCapture(event.pointerId);
  });
  const locked = () => document.pointerLockElement === canvas;
  canvas.addEventListener("pointermove", (event) => {
    if (event.pointerType === "touch") return;
    at = locked() ? [at[0] + event.movementX, at[1] + event.movementY] : [event.clientX, event.clientY];
    say("pointer", { x: at[0], y: at[1] });
  });
  canvas.addEventListener("pointerup", (event) => {
    if (event.pointerType !== "touch" && !locked()) say("drag", { down: false });
  });
  canvas.addEventListener("dblclick", () => canvas.requestPointerLock?.());
  document.addEventListener("pointerlockchange", () => say("drag", { down: locked() }));
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    say("wheel", { notches: -Math.sign(event.deltaY) });
  }, { passive: false });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
}

/** The left thumb is a stick that appears where it touches; the right one looks. */
function touch() {
  let walking = null;
  const stick = ([x, y]) => say("sticks", { walk: [x, y], look: [0, 0], climb: 0 });
  const within = (value) => Math.max(-1, Math.min(1, value));
  canvas.addEventListener("pointerdown", (event) => {
    if (event.pointerType !== "touch") return;
    canvas.setPointerCapture(event.pointerId);
    if (walking === null && event.clientX < innerWidth * WALK_PART) {
      walking = { id: event.pointerId, x: event.clientX, y: event.clientY };
      Object.assign(by("stick").style, { left: `${event.clientX - 55}px`, top: `${event.clientY - 55}px` });
      show("stick", true);
    } else say("touch", { phase: "begin", id: event.pointerId, x: event.clientX, y: event.clientY });
  });
  canvas.addEventListener("pointermove", (event) => {
    if (event.pointerType !== "touch") return;
    if (walking?.id === event.pointerId) {
      const way = [within((event.clientX - walking.x) / STICK_PX), within((walking.y - event.clientY) / STICK_PX)];
      by("thumb").style.transform = `translate(${way[0] * 30}px, ${-way[1] * 30}px)`;
      stick(way);
    } else say("touch", { phase: "go", id: event.pointerId, x: event.clientX, y: event.clientY });
  });
  const end = (event) => {
    if (event.pointerType !== "touch") return;
    if (walking?.id === event.pointerId) {
      walking = null;
      show("stick", false);
      by("thumb").style.transform = "";
      stick([0, 0]);
    } else say("touch", { phase: "end", id: event.pointerId, x: event.clientX, y: event.clientY });
  };
  canvas.addEventListener("pointerup", end);
  canvas.addEventListener("pointercancel", end);
}

function gamepads() {
  const pad = navigator.getGamepads().find((pad) => pad?.mapping === "standard");
  if (pad) {
    const [walkX, walkY, lookX, lookY] = pad.axes;
    const climb = (pad.buttons[7]?.value ?? 0) - (pad.buttons[6]?.value ?? 0);
    say("sticks", { walk: [walkX, -walkY], look: [lookX, -lookY], climb });
  }
  requestAnimationFrame(gamepads);
}

start();
