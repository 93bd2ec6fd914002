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
 * Opens a way to `host`. `server` is its gnomon.json. `hear` gets `control(bytes)`, `datagram(bytes)` and, once and last,
 * `closed({ code, reason })`.
 */
export async function open(server, host, hear) {
  if (typeof WebTransport === "undefined") throw new NotOpened("this browser has no WebTransport");
  return openWebTransport(server, host, hear);
}

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
      `UDP port ${server.port} of ${host} is not reached (${error.message.replace(/\.$/, "")}): a network on the way drops UDP, or ` +
        "the server's certificate is not the one that it announces",
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
