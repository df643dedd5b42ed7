"""A network between browser and server that can be pulled: a TCP relay which goes silent without closing anything."""

import asyncio
import contextlib
import threading
from typing import Self

from recording.clock import mono_ns

_BYTES = 65536


class Network(threading.Thread):
    """Listens on `port`, passes to the server's; while pulled, bytes of both directions wait."""

    def __init__(self, server_port: int) -> None:
        super().__init__(name="network", daemon=True)
        self._server_port = server_port
        self._loop = asyncio.new_event_loop()
        self._plugged = asyncio.Event()
        self._ready = threading.Event()
        self._over = asyncio.Event()
        self.port = 0

    def __enter__(self) -> Self:
        self.start()
        self._ready.wait(10.0)
        return self

    def __exit__(self, *_error: object) -> None:
        self._loop.call_soon_threadsafe(self._over.set)
        self.join(5.0)

    def pull(self) -> int:
        """From now on nothing comes through; the moment of it [mono ns]."""
        done = threading.Event()
        self._loop.call_soon_threadsafe(lambda: (self._plugged.clear(), done.set()))
        done.wait(1.0)
        return mono_ns()

    def plug_in(self) -> None:
        """What has waited goes on."""
        self._loop.call_soon_threadsafe(self._plugged.set)

    def run(self) -> None:
        """Until closed."""
        self._loop.run_until_complete(self._serve())
        self._loop.close()

    async def _serve(self) -> None:
        self._plugged.set()
        server = await asyncio.start_server(self._connection, "127.0.0.1", 0)
        self.port = server.sockets[0].getsockname()[1]
        self._ready.set()
        await self._over.wait()
        server.close()
        for task in asyncio.all_tasks():
            if task is not asyncio.current_task():
                task.cancel()

    async def _connection(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError, asyncio.CancelledError):
            there_reader, there_writer = await asyncio.open_connection("127.0.0.1", self._server_port)
            await asyncio.gather(self._pass(reader, there_writer), self._pass(there_reader, writer))

    async def _pass(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError):
            while data := await reader.read(_BYTES):
                await self._plugged.wait()
                writer.write(data)
                await writer.drain()
        with contextlib.suppress(OSError):
            writer.close()
