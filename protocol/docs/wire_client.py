#!/usr/bin/env python3
"""A client written from wire.md alone: one mask, drawn with characters. Needs aioquic.

usage: wire_client.py 'gnomon://HOST:PORT/?cert=SHA256' [X Y Z]   (GNOMON_TOKEN names the token)
Looks along -Z from X Y Z."""
import asyncio, hashlib, os, ssl, struct, sys
from urllib.parse import parse_qs, urlsplit
from aioquic.asyncio.client import connect
from aioquic.asyncio.protocol import QuicConnectionProtocol
from aioquic.quic.configuration import QuicConfiguration
from aioquic.quic.events import DatagramFrameReceived, StreamDataReceived
from cryptography.hazmat.primitives.serialization import Encoding

VERSION, PLANES_LZ4, WIDTH, HEIGHT = 7, 2, 72, 40


def varint(value):
    out = b""
    while value > 127:
        out, value = out + bytes([value & 127 | 128]), value >> 7
    return out + bytes([value])


def text(value):
    return varint(len(value.encode())) + value.encode()


def message(number, fields=b""):
    return struct.pack("<I", 1 + len(fields)) + bytes([number]) + fields


class Reader:
    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, count):
        self.at += count
        return self.data[self.at - count : self.at]

    def varint(self):
        value = shift = 0
        while True:
            (byte,) = self.take(1)
            value, shift = value | (byte & 127) << shift, shift + 7
            if byte < 128:
                return value


def lz4_block(data, length):
    """LZ4's block format; a slice of the raw length is raw."""
    if len(data) == length:
        return data
    out, read = bytearray(), Reader(data)

    def count_of(nibble):
        count, goes_on = nibble, nibble == 15
        while goes_on:
            (byte,) = read.take(1)
            count, goes_on = count + byte, byte == 255
        return count

    while True:
        (token,) = read.take(1)
        out += read.take(count_of(token >> 4))
        if read.at == len(data):
            return bytes(out)
        (offset,) = struct.unpack("<H", read.take(2))
        for _ in range(count_of(token & 15) + 4):
            out.append(out[-offset])


def mask_of(body):
    """Planes of rows of bits."""
    codec, width, height, lights, slices = struct.unpack_from("<BHHBH", body)
    assert codec == PLANES_LZ4 and lights < 64, "a pose or a reference was not asked for"
    lengths = struct.unpack_from(f"<{slices}I", body, 8)
    at, tiles_x, rows = 8 + 4 * slices, -(-width // 8), -(-height // 8)
    planes = [[[0] * width for _ in range(height)] for _ in range(lights)]
    for index, length in enumerate(lengths):
        first, end = index * rows // slices, (index + 1) * rows // slices
        tiles = (end - first) * tiles_x
        raw = lz4_block(body[at : at + length], lights * tiles * 8)
        at += length
        for place, tile in enumerate(struct.unpack(f"<{lights * tiles}Q", raw)):
            light, y, x = place // tiles, first + place % tiles // tiles_x, place % tiles_x
            for bit in range(64):
                if tile >> bit & 1:
                    planes[light][8 * y + bit // 8][8 * x + bit % 8] = 1
    return planes


class Client(QuicConnectionProtocol):
    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.control, self.messages, self.packets = b"", asyncio.Queue(), asyncio.Queue()

    def quic_event_received(self, event):
        if isinstance(event, DatagramFrameReceived):
            self.packets.put_nowait(event.data)
        if isinstance(event, StreamDataReceived):
            self.control += event.data
            while len(self.control) >= 4:
                (size,) = struct.unpack_from("<I", self.control)
                if len(self.control) < 4 + size:
                    break
                self.messages.put_nowait(Reader(self.control[4 : 4 + size]))
                self.control = self.control[4 + size :]

    def say(self, data):
        self._quic.send_stream_data(0, data)
        self.transmit()

    async def answer(self, expected):
        read = await asyncio.wait_for(self.messages.get(), 60)
        number = read.varint()
        assert number == expected, f"message {number}: {read.data!r}"
        return read

    async def frame(self, position):
        """Sends the pose of frame 0 until its mask comes."""
        pose = struct.pack("<9d", *position, 0, 0, 0, 1, 1.2, 0) + struct.pack("<IHHHI", 0, WIDTH, HEIGHT, 0, 0)
        parts = {}
        for sequence in range(200):
            header = struct.pack("<IIHHI", sequence, 0, len(pose), 0, 0xFFFFFFFF)
            self._quic.send_datagram_frame(header + pose)
            self.transmit()
            try:
                while True:
                    packet = await asyncio.wait_for(self.packets.get(), 0.3)
                    number, frame, size, count, _ = struct.unpack_from("<IIHHI", packet)
                    if frame == 0 and count and size == len(packet) - 16:
                        parts[number] = packet[16:]
                        if len(parts) == count >> 1:
                            return b"".join(data for _, data in sorted(parts.items()))
            except asyncio.TimeoutError:
                parts.clear()
        raise SystemExit("no mask")


async def main():
    url, position = urlsplit(sys.argv[1]), [float(value) for value in sys.argv[2:5]] or [0, 0, 0]
    setting = QuicConfiguration(is_client=True, alpn_protocols=["gnomon/1"], max_datagram_frame_size=65536)
    setting.verify_mode = ssl.CERT_NONE
    async with connect(url.hostname, url.port, configuration=setting, create_protocol=Client) as client:
        shown = client._quic.tls._peer_certificate.public_bytes(Encoding.DER)
        assert hashlib.sha256(shown).hexdigest() in parse_qs(url.query)["cert"], "another server"
        token = os.environ.get("GNOMON_TOKEN")
        hello = varint(VERSION) + (b"\1" + text(token) if token else b"\0") + text("wire_client.py")
        hello += varint(WIDTH) + varint(HEIGHT) + varint(PLANES_LZ4) + varint(0) + varint(0) + b"\0"
        client.say(message(0, hello))
        welcome = await client.answer(0)
        session, digest, length, lights = welcome.varint(), welcome.take(32), welcome.varint(), welcome.varint()
        backend = welcome.take(welcome.varint()).decode()
        print(f"session {session}: {lights} lights by {backend!r}, scene {digest.hex()} of {length} bytes")
        client.say(message(1, varint(0)))
        scene = b""
        while len(scene) < length:
            chunk = await client.answer(2)
            assert chunk.varint() == len(scene)
            scene += chunk.take(chunk.varint())
        assert scene.startswith(b"GNOMSCNE")
        client.say(message(2))
        planes = mask_of(await client.frame(position))
        for y in range(0, HEIGHT, 2):
            print("".join(" .:*#"[min(4, sum(plane[y][x] for plane in planes))] for x in range(WIDTH)))
        client.say(message(4))
        print(f"lit {sum(map(sum, (row for plane in planes for row in plane)))} of {WIDTH * HEIGHT * lights}")


asyncio.run(main())
