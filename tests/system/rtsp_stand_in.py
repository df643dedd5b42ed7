"""A network camera for tests: RTSP over TCP with JPEG in RTP (RFC 2326, RFC 2435), one picture after the other."""

import socket
import struct
import threading
import time
from types import TracebackType

SESSION = "12345"
CLOCK_HZ = 90_000
MAX_BYTES = 1400


def _segments(jpeg: bytes) -> tuple[bytes, bytes, int, int, int]:
    """Quantisation tables, scan data, width, height and RFC 2435 type of a baseline JPEG of three components."""
    tables, at, width, height, kind = b"", 2, 0, 0, 1
    while True:
        marker, length = jpeg[at + 1], struct.unpack(">H", jpeg[at + 2 : at + 4])[0]
        body = jpeg[at + 4 : at + 2 + length]
        if marker == 0xDB:
            for k in range(0, len(body), 65):
                tables += body[k + 1 : k + 65]
        elif marker == 0xC0:
            height, width = struct.unpack(">HH", body[1:5])
            kind = 1 if body[7] == 0x22 else 0
        elif marker == 0xDA:
            return tables, jpeg[at + 2 + length :].removesuffix(b"\xff\xd9"), width, height, kind
        at += 2 + length


class RtspStandIn:
    """Serves JPEG pictures (4:2:0 or 4:2:2, sides multiples of 16) at a rate; hangs up after the last one."""

    def __init__(self, jpegs: list[bytes], rate_hz: float) -> None:
        self._jpegs, self._rate_hz = jpegs, rate_hz
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"rtsp://127.0.0.1:{self._listener.getsockname()[1]}/both"
        self.transports: list[str] = []
        self._closing = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def __enter__(self) -> "RtspStandIn":
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._closing = True
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join(5.0)

    def _run(self) -> None:
        while not self._closing:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            with client:
                try:
                    self._serve(client)
                except OSError:
                    continue

    def _serve(self, client: socket.socket) -> None:
        client.settimeout(5.0)
        buffer = b""
        while True:
            while b"\r\n\r\n" not in buffer:
                data = client.recv(4096)
                if not data:
                    return
                buffer += data
            request, _, buffer = buffer.partition(b"\r\n\r\n")
            lines = request.decode().split("\r\n")
            method = lines[0].split()[0]
            fields = {line.partition(":")[0].lower(): line.partition(":")[2].strip() for line in lines[1:]}
            client.sendall(self._answer(method, fields))
            if method == "PLAY":
                self._stream(client)
                return

    def _answer(self, method: str, fields: dict[str, str]) -> bytes:
        head = f"RTSP/1.0 200 OK\r\nCSeq: {fields.get('cseq', '0')}\r\nSession: {SESSION}\r\n"
        body = ""
        if method == "OPTIONS":
            head += "Public: OPTIONS, DESCRIBE, SETUP, PLAY, TEARDOWN\r\n"
        elif method == "DESCRIBE":
            body = (
                "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=both\r\nc=IN IP4 0.0.0.0\r\nt=0 0\r\n"
                "m=video 0 RTP/AVP 26\r\na=control:track0\r\n"
            )
            head += f"Content-Base: {self.url}/\r\nContent-Type: application/sdp\r\nContent-Length: {len(body)}\r\n"
        elif method == "SETUP":
            self.transports.append(fields.get("transport", ""))
            head += "Transport: RTP/AVP/TCP;unicast;interleaved=0-1\r\n"
        return (head + "\r\n" + body).encode()

    def _stream(self, client: socket.socket) -> None:
        sequence = 0
        for number, jpeg in enumerate(self._jpegs):
            for packet in self._packets(jpeg, round(number * CLOCK_HZ / self._rate_hz), sequence):
                client.sendall(b"$\x00" + struct.pack(">H", len(packet)) + packet)
                sequence += 1
            time.sleep(1.0 / self._rate_hz)

    def _packets(self, jpeg: bytes, stamp: int, sequence: int) -> list[bytes]:
        tables, scan, width, height, kind = _segments(jpeg)
        packets = []
        for offset in range(0, len(scan), MAX_BYTES):
            part = scan[offset : offset + MAX_BYTES]
            last = offset + MAX_BYTES >= len(scan)
            rtp = struct.pack(">BBHII", 0x80, 26 | (0x80 if last else 0), (sequence + len(packets)) & 0xFFFF, stamp, 1)
            own = struct.pack(">I", offset) + bytes([kind, 255, width // 8, height // 8])
            quantisation = struct.pack(">BBH", 0, 0, len(tables)) + tables if offset == 0 else b""
            packets.append(rtp + own + quantisation + part)
        return packets
