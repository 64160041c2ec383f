"""A network camera: an RTSP server (RFC 2326) that shows a clip once as motion JPEG over RTP (RFC 2435), in step with
the clock and whether or not anybody keeps up."""

from __future__ import annotations

import socketserver
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import cv2
import numpy as np

PAYLOAD_JPEG = 26
CLOCK_HZ = 90_000
PACKET_BYTES = 1400
SUBSAMPLED_420 = 1
TABLES_INSIDE = 255
METHODS = "OPTIONS, DESCRIBE, SETUP, PLAY, TEARDOWN"


def parts_of(jpeg: bytes) -> tuple[bytes, bytes]:
    """The quantisation tables and the entropy-coded data; the rest of a baseline JPEG is in the RTP header."""
    tables, at = b"", 2
    while True:
        marker, length = jpeg[at + 1], struct.unpack_from(">H", jpeg, at + 2)[0]
        segment = jpeg[at + 4 : at + 2 + length]
        at += 2 + length
        if marker == 0xDB:
            tables += b"".join(segment[i + 1 : i + 65] for i in range(0, len(segment), 65))
        elif marker == 0xDA:
            return tables, jpeg[at:-2]


def packets(image: np.ndarray, sequence: int, timestamp: int) -> Iterator[bytes]:
    """One frame as RTP packets, each framed for the RTSP connection itself (interleaved)."""
    done, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 85])
    assert done
    tables, data = parts_of(jpeg.tobytes())
    height, width = image.shape[:2]
    at = 0
    while at < len(data):
        head = struct.pack(">I", at) + bytes((SUBSAMPLED_420, TABLES_INSIDE, width // 8, height // 8))
        if at == 0:
            head += struct.pack(">BBH", 0, 0, len(tables)) + tables
        part = data[at : at + PACKET_BYTES]
        at += len(part)
        last = 0x80 if at == len(data) else 0
        rtp = (
            struct.pack(">BBHII", 0x80, last | PAYLOAD_JPEG, sequence & 0xFFFF, timestamp & 0xFFFFFFFF, 1) + head + part
        )
        sequence += 1
        yield b"$\0" + struct.pack(">H", len(rtp)) + rtp


@contextmanager
def camera(images: list[np.ndarray], fps: float) -> Iterator[str]:
    """The URL of a camera that shows ``images`` (sides divisible by 8) at ``fps`` to each client that plays it."""
    over = threading.Event()

    class Client(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            while head := self._request():
                method, url, fields = head
                if method == "OPTIONS":
                    self._answer(fields, f"Public: {METHODS}\r\n")
                elif method == "DESCRIBE":
                    sdp = f"v=0\r\no=- 1 1 IN IP4 127.0.0.1\r\ns=clip\r\nt=0 0\r\nm=video 0 RTP/AVP {PAYLOAD_JPEG}\r\n"
                    sdp += "c=IN IP4 127.0.0.1\r\na=control:track0\r\n"
                    about = f"Content-Base: {url}/\r\nContent-Type: application/sdp\r\nContent-Length: {len(sdp)}\r\n"
                    self._answer(fields, about, sdp)
                elif method == "SETUP":
                    self._answer(fields, "Transport: RTP/AVP/TCP;unicast;interleaved=0-1\r\nSession: 1\r\n")
                elif method == "PLAY":
                    self._answer(fields, "Session: 1\r\n")
                    self._play()
                    return
                else:
                    self._answer(fields, "Session: 1\r\n")

        def _request(self) -> tuple[str, str, dict[str, str]] | None:
            first = self.rfile.readline().decode().split()
            fields = {}
            while line := self.rfile.readline().decode().strip():
                name, _, value = line.partition(":")
                fields[name.lower()] = value.strip()
            return (first[0], first[1].rstrip("/"), fields) if first else None

        def _answer(self, fields: dict[str, str], about: str, body: str = "") -> None:
            self.wfile.write(f"RTSP/1.0 200 OK\r\nCSeq: {fields['cseq']}\r\n{about}\r\n{body}".encode())

        def _play(self) -> None:
            sequence = 0
            try:
                for index, image in enumerate(images):
                    for packet in packets(image, sequence, round(index * CLOCK_HZ / fps)):
                        self.wfile.write(packet)
                        sequence += 1
                    if over.wait(1 / fps):
                        return
            except OSError:
                pass  # the client has gone

    server = socketserver.ThreadingTCPServer(("127.0.0.1", 0), Client)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"rtsp://127.0.0.1:{server.server_address[1]}/clip"
    finally:
        over.set()
        server.shutdown()
        server.server_close()
        thread.join()
