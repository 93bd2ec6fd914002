// A way to the server: a control stream, and datagrams that may be lost. Nothing queues here: what cannot go out at once
// is dropped, since a newer one follows.

/** How long WebTransport may take to open. */
const OPEN_MS = 2000;

export class NotOpened extends Error {}

function bytes(hex) {
  return Uint8Array.from(hex.match(/../g) ?? [], (byte) => parseInt(byte, 16));
}

function after(ms, error) {
  return new Promise((_, reject) => setTimeout(() => reject(error), ms));
}

/**
 * Opens a way to the server: WebTransport, or else a WebSocket. `server` is its gnomon.json, `address` where that came
 * from. `hear` gets `control(bytes)`, `datagram(bytes)` and, once and last, `closed({ code, reason })`.
 */
export async function open(server, address, hear) {
  const host = new URL(address).hostname;
  let failure = fellBack ?? new NotOpened("this browser has no WebTransport");
  if (typeof WebTransport !== "undefined" && !fellBack) {
    try {
      return await openWebTransport(server, host, hear);
    } catch (error) {
      if (!(error instanceof NotOpened) || !server.websocket) throw error;
      failure = error;
    }
  }
  const link = await openWebSocket(new URL(server.websocket, address), hear).catch((error) => {
    throw new NotOpened(`${failure.message}; ${error.message}`);
  });
  // A network that drops UDP will go on doing so.
  fellBack = failure;
  return { ...link, why: failure.message };
}

/** Why WebTransport did not open. */
let fellBack = null;

async function openWebTransport(server, host, hear) {
  const pinned = server.certificate_sha256;
  const options = { congestionControl: "low-latency" };
  if (pinned) {
    const hashes = [pinned.current, pinned.next].filter(Boolean);
    options.serverCertificateHashes = hashes.map((hash) => ({ algorithm: "sha-256", value: bytes(hash) }));
  }
  const session = new WebTransport(`https://${host}:${server.port}/`, options);
  session.closed.catch(() => {});
  try {
    await Promise.race([session.ready, after(OPEN_MS, new Error(`no answer within ${OPEN_MS / 1000} s`))]);
  } catch (error) {
    session.close();
    throw new NotOpened(
      `WebTransport does not reach UDP port ${server.port} of ${host} (${error.message.replace(/\.$/, "")}): a network on ` +
        "the way drops UDP, or the server's certificate is not the one that it announces",
    );
  }
  const { datagrams } = session;
  // They are 1 unless set, and a frame is many.
  for (const name of ["incomingHighWaterMark", "incomingMaxBufferedDatagrams"]) {
    if (name in datagrams) datagrams[name] = 1024;
  }
  const stream = await session.createBidirectionalStream();
  const control = stream.writable.getWriter();
  const outgoing = (datagrams.writable ?? datagrams.createWritable()).getWriter();
  const read = async (readable, take) => {
    const reader = readable.getReader();
    for (;;) {
      const { value, done } = await reader.read();
      if (done) return;
      take(value);
    }
  };
  const reading = [read(stream.readable, hear.control), read(datagrams.readable, hear.datagram)];
  reading.forEach((done) => done.catch(() => {}));
  session.closed
    .then(({ closeCode, reason }) => ({ code: closeCode, reason }), (error) => ({ code: null, reason: error.message }))
    // What came before the end is heard before it.
    .then(async (end) => {
      await Promise.race([Promise.allSettled(reading), new Promise((resolve) => setTimeout(resolve, 200))]);
      hear.closed(end);
    });
  return {
    kind: "WebTransport",
    control: (message) => control.write(message).catch(() => {}),
    datagram: (packet) => {
      if (outgoing.desiredSize === null || outgoing.desiredSize > 0) outgoing.write(packet).catch(() => {});
    },
    close: () => session.close({ closeCode: 0, reason: "done" }),
  };
}

/** Messages begin with a byte: the control stream's bytes, or datagrams. */
const CONTROL = 0;
const DATA = 1;

/** A WebSocket's code for a session that ends as WebTransport's does with code 0. */
const FIRST_CODE = 4000;

/** Unsent bytes above which a newer pose had better wait. */
const MOST_UNSENT = 1024;

async function openWebSocket(url, hear) {
  url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
  const socket = new WebSocket(url);
  socket.binaryType = "arraybuffer";
  await new Promise((opened, failed) => {
    const error = new Error("a WebSocket does not open either");
    socket.onopen = opened;
    socket.onerror = () => failed(error);
    setTimeout(() => failed(error), 2 * OPEN_MS);
  }).catch((error) => {
    socket.close();
    throw error;
  });
  socket.onmessage = ({ data }) => {
    const message = new Uint8Array(data);
    if (message[0] === CONTROL) hear.control(message.subarray(1));
    // A frame: its packets, each after its length.
    for (let at = 1; message[0] === DATA && at + 2 <= message.length; ) {
      const end = at + 2 + message[at] + 256 * message[at + 1];
      hear.datagram(message.subarray(at + 2, end));
      at = end;
    }
  };
  socket.onerror = null;
  socket.onclose = ({ code, reason }) => hear.closed({ code: code >= FIRST_CODE ? code - FIRST_CODE : null, reason });
  const send = (kind, bytes) => {
    const message = new Uint8Array(1 + bytes.length);
    message[0] = kind;
    message.set(bytes, 1);
    socket.send(message);
  };
  return {
    kind: "WebSocket",
    control: (bytes) => send(CONTROL, bytes),
    datagram: (bytes) => {
      if (socket.bufferedAmount < MOST_UNSENT) send(DATA, bytes);
    },
    close: () => socket.close(1000),
  };
}
