"""A lean HTTP/1.1 client: a full one costs more CPU per request than the server it is meant to measure."""

import asyncio
from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Self

_READ_MAX = 1 << 20


class AnswerError(Exception):
    """The server's answer is not what this client can read; the text says what came."""


@dataclass(frozen=True, slots=True)
class Answer:
    """Status and body of one request."""

    status: int
    body: bytes


class Connection:
    """One kept-alive connection to a server; made anew by its owner when it breaks."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, host: str) -> None:
        self._reader, self._writer, self._host = reader, writer, host

    @classmethod
    async def opened(cls, host: str, port: int) -> Self:
        """Connect. Raises: OSError."""
        return cls(*await asyncio.open_connection(host, port, limit=_READ_MAX), f"{host}:{port}")

    async def get(self, path: str) -> Answer:
        """One request and its whole answer.

        Raises: OSError, EOFError: the connection broke. AnswerError: an answer without a length.
        """
        status, head = await self._asked(path, "application/json")
        return Answer(status, await self._reader.readexactly(_length(head)))

    async def stream(self, path: str) -> AsyncIterator[bytes]:
        """The lines of an answer without end. Raises: OSError: it broke. AnswerError: refused."""
        status, _ = await self._asked(path, "text/event-stream")
        if status != 200:
            raise AnswerError(f"{path}: status {status}")
        while line := await self._reader.readline():
            yield line

    async def _asked(self, path: str, accept: str) -> tuple[int, bytes]:
        self._writer.write(f"GET {path} HTTP/1.1\r\nHost: {self._host}\r\nAccept: {accept}\r\n\r\n".encode())
        await self._writer.drain()
        head = await self._reader.readuntil(b"\r\n\r\n")
        return int(head.split(b" ", 2)[1]), head.lower()

    def close(self) -> None:
        """Let go of it."""
        self._writer.close()


def _length(head: bytes) -> int:
    for line in head.split(b"\r\n"):
        if line.startswith(b"content-length:"):
            return int(line[15:])
    raise AnswerError("an answer without Content-Length")
