"""The multipart parser: every cut of the stream, every damage."""

import numpy as np
import pytest

from server.camera.errors import StreamError
from server.camera.sources.multipart import BODY_LIMIT_BYTES, MultipartParser

STREAM = (
    b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: 5\r\n"
    b"X-Exposure-Ns: 1000\r\nX-Sequence: 7\r\n\r\nab\r\nc\r\n"
    b"--frame\r\ncontent-length: 3\r\n\r\nxyz\r\n"
    b"--frame\r\nContent-Length: 1\r\nX-Exposure-Ns: -5\r\nX-Sequence: 9\r\n\r\n!\r\n"
)


@pytest.mark.parametrize("chunk", [1, 2, 3, 7, 50, 1000])
def test_parts_do_not_depend_on_how_bytes_arrive(chunk: int) -> None:
    parser = MultipartParser()
    parts = [part for at in range(0, len(STREAM), chunk) for part in parser.feed(STREAM[at : at + chunk], at)]
    assert [part.body for part in parts] == [b"ab\r\nc", b"xyz", b"!"]
    assert [part.t_exposure_ns for part in parts] == [1000, None, -5]
    assert [part.sequence for part in parts] == [7, None, 9]


def test_receive_time_is_that_of_the_header() -> None:
    parser = MultipartParser()
    assert parser.feed(b"--x\r\nContent-Length: 4\r\n\r\nab", 10) == []
    (part,) = parser.feed(b"cd", 20)
    assert part.t_header_ns == 10


@pytest.mark.parametrize(
    "stream",
    [
        b"HTTP nonsense\r\n\r\n",
        b"--x\r\nContent-Length: 0\r\n\r\n",
        b"--x\r\nContent-Length: -4\r\n\r\n",
        b"--x\r\nContent-Length: 4e3\r\n\r\n",
        b"--x\r\nContent-Length: %d\r\n\r\n" % (BODY_LIMIT_BYTES + 1),
        b"--x\r\nContent-Length: 4\r\nX-Exposure-Ns: soon\r\n\r\n",
        b"--x\r\nContent-Length: 4\r\nX-Sequence: --5\r\n\r\n",
        b"--x\r\nContent-Length: 4\r\nX-Sequence: -\r\n\r\n",
        b"-" * 9000,
    ],
)
def test_what_is_not_multipart_is_refused(stream: bytes) -> None:
    with pytest.raises(StreamError):
        MultipartParser().feed(stream, 0)


def test_random_bytes_give_parts_or_stream_error() -> None:
    rng = np.random.default_rng(11)
    for _ in range(500):
        damaged = bytearray(STREAM)
        for place in rng.integers(0, len(STREAM), 4):
            damaged[place] = int(rng.integers(0, 256))
        try:
            parts = MultipartParser().feed(bytes(damaged), 0)
        except StreamError:
            continue
        assert sum(len(part.body) for part in parts) <= len(STREAM)
