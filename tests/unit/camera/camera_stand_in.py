"""A camera server for tests: sends the parts it is told to, when it is told to."""

import socket
import threading
from types import TracebackType

import cv2
import numpy as np

from server.vision.contracts import Image

CONNECTED_S = 240.0  # a first start compiles


def jpeg_of(picture: Image) -> bytes:
    good, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 95])
    if not good:
        raise ValueError("picture cannot be encoded")
    return data.tobytes()


def part_of(body: bytes, exposure_ns: int | None, sequence: int | None) -> bytes:
    header = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(body)}\r\n"
    if exposure_ns is not None:
        header += f"X-Exposure-Ns: {exposure_ns}\r\n"
    if sequence is not None:
        header += f"X-Sequence: {sequence}\r\n"
    return header.encode() + b"\r\n" + body + b"\r\n"


def picture(left_grey: int, right_grey: int, noise_seed: int = 0) -> Image:
    """Two small eyes of different grey with noise."""
    rng = np.random.default_rng(noise_seed)
    eyes = [np.full((60, 80), grey) + rng.integers(-9, 10, (60, 80)) for grey in (left_grey, right_grey)]
    return np.clip(np.hstack(eyes), 0, 255).astype(np.uint8)


class CameraStandIn:
    """Listens on a free port; `send` waits for the client's connection."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}/stream"
        self._client: socket.socket | None = None
        self._connected = threading.Event()
        self._closing = False
        self._thread = threading.Thread(target=self._accept, daemon=True)
        self._thread.start()

    def __enter__(self) -> "CameraStandIn":
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._closing = True
        self.hang_up()
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join(5.0)

    def _accept(self) -> None:
        while not self._closing:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            client.recv(4096)
            client.sendall(
                b"HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=frame\r\n"
                b"Connection: close\r\n\r\n"
            )
            if self._client is not None:
                self._client.close()
            self._client = client
            self._connected.set()

    def send(self, data: bytes) -> None:
        if not self._connected.wait(CONNECTED_S) or self._client is None:
            raise TimeoutError(f"nobody connected to the stand-in camera within {CONNECTED_S:.0f} s")
        self._client.sendall(data)

    def hang_up(self) -> None:
        self._connected.clear()
        if self._client is not None:
            self._client.close()
            self._client = None
