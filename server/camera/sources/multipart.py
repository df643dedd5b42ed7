"""multipart/x-mixed-replace without IO: bytes in, parts out, in the forms that camera servers give it.

Lines may end in LF alone, and parts need not say their length: then one ends where a JPEG ends with what has arrived,
or at the next boundary.
"""

import re
from dataclasses import dataclass

from server.camera.errors import StreamError

HEADER_LIMIT_BYTES = 8192
INTEGER_PATTERN = re.compile(rb"-?[0-9]{1,19}")
BODY_LIMIT_BYTES = 32 << 20  # an uncompressed 2 x 4 megapixel picture fits
HEADER_END_PATTERN = re.compile(rb"\r?\n\r?\n")
JPEG_START, JPEG_END = b"\xff\xd8", b"\xff\xd9"  # within a JPEG's data the end cannot occur


@dataclass(frozen=True, slots=True)
class MultipartPart:
    """One part of the stream. Stamps are None where the camera gives none; `t_header_ns`: its header was seen."""

    body: bytes
    t_exposure_ns: int | None
    sequence: int | None
    t_header_ns: int


@dataclass(frozen=True, slots=True)
class _Header:
    """`body_length`: None where the camera does not say it; `t_ns` is then when the body began: the header may wait."""

    delimiter: bytes
    body_length: int | None
    t_exposure_ns: int | None
    sequence: int | None
    t_ns: int | None


def _integer_header(fields: dict[bytes, bytes], name: bytes) -> int | None:
    text = fields.get(name)
    if text is None:
        return None
    if not INTEGER_PATTERN.fullmatch(text):
        raise StreamError(f"camera stream: header {name.decode()} = {text[:40]!r} is not a whole number")
    return int(text)


def _parse_header(block: bytes, boundary: bytes, t_ns: int) -> _Header:
    lines = [line.strip() for line in block.splitlines() if line.strip()]
    if not lines or not (lines[0].startswith(b"--") or lines[0] == boundary):
        raise StreamError(f"camera stream: expected a boundary, found {block[:40]!r}; is this a multipart stream?")
    pairs = [line.partition(b":") for line in lines[1:]]
    fields = {name.strip().lower(): value.strip() for name, _, value in pairs}
    length = _integer_header(fields, b"content-length")
    if length is not None and not 0 < length <= BODY_LIMIT_BYTES:
        raise StreamError(f"camera stream: Content-Length {length} (limit 1..{BODY_LIMIT_BYTES} bytes)")
    stamps = _integer_header(fields, b"x-exposure-ns"), _integer_header(fields, b"x-sequence")
    return _Header(lines[0], length, *stamps, None if length is None else t_ns)


class MultipartParser:
    """Takes bytes as they arrive; any bytes give parts or StreamError, nothing else.

    `boundary`: as the response's Content-Type says it; needed only for a camera that writes it without dashes.
    """

    def __init__(self, boundary: bytes = b"") -> None:
        self._buffer = bytearray()
        self._boundary = boundary
        self._header: _Header | None = None
        self._t_body_ns: int | None = None
        self._searched = 0  # of the buffer, for the boundary behind a body

    def feed(self, data: bytes, t_mono_ns: int) -> list[MultipartPart]:
        """Parts completed by these bytes, in order."""
        self._buffer += data
        parts: list[MultipartPart] = []
        while True:
            if self._header is None and not self._take_header(t_mono_ns):
                return parts
            header = self._header
            if header is None:
                return parts
            if self._t_body_ns is None and self._buffer:
                self._t_body_ns = t_mono_ns if header.t_ns is None else header.t_ns
            body = self._take_body(header)
            if body is None:
                return parts
            t_ns = t_mono_ns if self._t_body_ns is None else self._t_body_ns
            parts.append(MultipartPart(body, header.t_exposure_ns, header.sequence, t_ns))
            self._header = None

    def _take_header(self, t_mono_ns: int) -> bool:
        while self._buffer[:1] in (b"\r", b"\n"):  # the line end behind the body before
            del self._buffer[:1]
        end = HEADER_END_PATTERN.search(self._buffer, 0, HEADER_LIMIT_BYTES)
        if end is None:
            if len(self._buffer) >= HEADER_LIMIT_BYTES:
                raise StreamError(f"camera stream: no end of a part's header within {HEADER_LIMIT_BYTES} bytes")
            return False
        self._header = _parse_header(bytes(self._buffer[: end.start()]), self._boundary, t_mono_ns)
        self._t_body_ns, self._searched = None, 0
        del self._buffer[: end.end()]
        return True

    def _take_body(self, header: _Header) -> bytes | None:
        """The body once it is whole, taken off the buffer."""
        if header.body_length is not None:
            return self._pop_buffered_bytes(header.body_length) if len(self._buffer) >= header.body_length else None
        delimiter = b"\n" + header.delimiter
        end = self._buffer.find(delimiter, self._searched)
        if end >= 0:
            return self._pop_buffered_bytes(end).removesuffix(b"\r")
        self._searched = max(0, len(self._buffer) - len(delimiter))
        if self._buffer.startswith(JPEG_START) and self._buffer[-4:].rstrip(b"\r\n").endswith(JPEG_END):
            return self._pop_buffered_bytes(len(self._buffer)).rstrip(b"\r\n")
        if len(self._buffer) > BODY_LIMIT_BYTES:
            raise StreamError(f"camera stream: no boundary within {BODY_LIMIT_BYTES} bytes of a part without a length")
        return None

    def _pop_buffered_bytes(self, length: int) -> bytes:
        body = bytes(self._buffer[:length])
        del self._buffer[:length]
        return body
