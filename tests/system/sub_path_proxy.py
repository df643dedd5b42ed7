"""A reverse proxy that puts a server under a path of its own, as nginx by `location /crane/ { proxy_pass .../; }`."""

import asyncio
import contextlib
import threading
from collections.abc import Iterator
from typing import Any
from urllib.parse import urlsplit

HEAD_MAX = 65_536


@contextlib.contextmanager
def under_path(url: str, path: str) -> Iterator[str]:
    """The address of the server of `url` under that path; everything else there is 404. HTTP and WebSocket."""
    target, started = urlsplit(url), threading.Event()
    opened: dict[str, Any] = {}
    carried: set[asyncio.Task[None]] = set()

    async def carry_one(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        if task is not None:
            carried.add(task)
        try:
            await carry(reader, writer)
        finally:
            writer.close()
            carried.discard(task)

    async def carry(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError, asyncio.IncompleteReadError):
            head = (await reader.readuntil(b"\r\n\r\n")).decode("latin1")
            request, *fields = head.split("\r\n")
            method, place, version = request.split(" ")
            if not place.startswith(path + "/"):
                writer.write(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")
            else:
                if not any(field.lower().startswith("upgrade:") for field in fields):  # one request a connection
                    fields = [field for field in fields if not field.lower().startswith("connection:")]
                    fields.insert(0, "Connection: close")
                there, back = await asyncio.open_connection(target.hostname, target.port, limit=HEAD_MAX)
                back.write("\r\n".join([f"{method} {place[len(path) :]} {version}", *fields]).encode("latin1"))
                try:
                    await asyncio.gather(pump(reader, back), pump(there, writer))
                finally:
                    back.close()

    async def pump(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError):
            while data := await reader.read(HEAD_MAX):
                writer.write(data)
                await writer.drain()
            writer.close()

    async def serve() -> None:
        listening = await asyncio.start_server(carry_one, "127.0.0.1", 0, limit=HEAD_MAX)
        opened["port"], opened["end"] = listening.sockets[0].getsockname()[1], asyncio.Event()
        opened["loop"] = asyncio.get_running_loop()
        started.set()
        await opened["end"].wait()
        listening.close()
        tasks = tuple(carried)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await asyncio.sleep(0.1)  # transports close in the loop's next turns

    thread = threading.Thread(target=lambda: asyncio.run(serve()), daemon=True)
    thread.start()
    started.wait()
    try:
        yield f"http://127.0.0.1:{opened['port']}{path}"
    finally:
        opened["loop"].call_soon_threadsafe(opened["end"].set)
        thread.join(5.0)
