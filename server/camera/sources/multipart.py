"""multipart/x-mixed-replace without IO: bytes in, parts out. Parts must carry Content-Length."""

import re
from dataclasses import dataclass

from server.camera.errors import StreamError

HEADER_LIMIT_BYTES = 8192
WHOLE_NUMBER = re.compile(rb"-?[0-9]{1,19}")
BODY_LIMIT_BYTES = 32 << 20  # an uncompressed 2 x 4 megapixel picture fits


@dataclass(frozen=True, slots=True)
class Part:
    """One part of the stream. Stamps are None where the camera gives none; `t_header_ns`: its header was seen."""

    body: bytes
    t_exposure_ns: int | None
    sequence: int | None
    t_header_ns: int


@dataclass(frozen=True, slots=True)
class _Header:
    length: int
    t_exposure_ns: int | None
    sequence: int | None
    t_header_ns: int


def _number(fields: dict[bytes, bytes], name: bytes) -> int | None:
    text = fields.get(name)
    if text is None:
        return None
    if not WHOLE_NUMBER.fullmatch(text):
        raise StreamError(f"camera stream: header {name.decode()} = {text[:40]!r} is not a whole number")
    return int(text)


def _parse_header(block: bytes, t_ns: int) -> _Header:
    lines = [line for line in block.split(b"\r\n") if line]
    if not lines or not lines[0].startswith(b"--"):
        raise StreamError(f"camera stream: expected a boundary, found {block[:40]!r}; is this a multipart stream?")
    pairs = [line.partition(b":") for line in lines[1:]]
    fields = {name.strip().lower(): value.strip() for name, _, value in pairs}
    length = _number(fields, b"content-length")
    if length is None or not 0 < length <= BODY_LIMIT_BYTES:
        raise StreamError(f"camera stream: Content-Length {length} (limit 1..{BODY_LIMIT_BYTES} bytes)")
    return _Header(length, _number(fields, b"x-exposure-ns"), _number(fields, b"x-sequence"), t_ns)


class MultipartParser:
    """Takes bytes as they arrive; any bytes give parts or StreamError, nothing else."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._header: _Header | None = None

    def feed(self, data: bytes, t_mono_ns: int) -> list[Part]:
        """Parts completed by these bytes, in order."""
        self._buffer += data
        parts: list[Part] = []
        while True:
            if self._header is None and not self._take_header(t_mono_ns):
                return parts
            header = self._header
            if header is None or len(self._buffer) < header.length:
                return parts
            body = bytes(self._buffer[: header.length])
            del self._buffer[: header.length]
            self._header = None
            parts.append(Part(body, header.t_exposure_ns, header.sequence, header.t_header_ns))

    def _take_header(self, t_mono_ns: int) -> bool:
        while self._buffer[:2] == b"\r\n":  # the line end behind the body before
            del self._buffer[:2]
        end = self._buffer.find(b"\r\n\r\n", 0, HEADER_LIMIT_BYTES)
        if end < 0:
            if len(self._buffer) >= HEADER_LIMIT_BYTES:
                raise StreamError(f"camera stream: no end of a part's header within {HEADER_LIMIT_BYTES} bytes")
            return False
        self._header = _parse_header(bytes(self._buffer[:end]), t_mono_ns)
        del self._buffer[: end + 4]
        return True
