"""The link process as the server holds it: started, read by a thread, written in order, and its end noticed."""

import asyncio
import contextlib
import logging
import multiprocessing
import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess

from protocol.limits import LimitTable
from recording.spawn import out_of_the_terminals_reach
from server.link.contracts import LinkReport, LinkRequest
from server.link.errors import LinkSilentError
from server.link.process import link_process_main
from server.link.settings import LinkSettings
from server.supervised_tasks import whole_in_thread

_LOG = logging.getLogger(__name__)
_END_S = 2.0  # the process needs at most 0.5 s for its STOP


class SupervisedProcess:
    """One life of the link process. `on_report` and `on_gone` are called in the event loop."""

    def __init__(
        self,
        settings: LinkSettings,
        table: LimitTable,
        on_report: Callable[[LinkReport], None],
        on_gone: Callable[[], None],
    ) -> None:
        self._loop = asyncio.get_running_loop()
        context = multiprocessing.get_context("spawn")
        self._pipe, self._child_pipe = context.Pipe(duplex=True)
        self._process: SpawnProcess = context.Process(
            target=link_process_main,
            args=(self._child_pipe, settings, table, os.getpid()),
            name="longreach-link",
            daemon=True,
        )
        # a thread of its own: a STOP must not queue behind other work of the default executor
        self._writer = ThreadPoolExecutor(1, thread_name_prefix="link-writer")

        args = (self._pipe, self._loop, on_report, on_gone)
        self._reader = threading.Thread(target=_read, args=args, name="link-reader", daemon=True)

    @property
    def pid(self) -> int | None:
        """Of the running process."""
        return self._process.pid

    async def start(self) -> None:
        """Spawn it and begin to read."""
        await whole_in_thread(self._start)
        self._child_pipe.close()
        self._reader.start()

    def _start(self) -> None:
        with out_of_the_terminals_reach():
            self._process.start()

    async def request(self, request: LinkRequest) -> None:
        """Hand a request over, in order. Raises: LinkSilentError: the process is gone."""
        try:
            await self._loop.run_in_executor(self._writer, self._pipe.send, request)
        except (OSError, RuntimeError) as error:
            raise LinkSilentError(
                f"the link process has ended ({error}); it restarts automatically, then arm"
            ) from error

    async def end_process(self) -> None:
        """Let it stop the machine and end; killed after 2 s."""
        if self._process.is_alive():
            self._process.terminate()
        await asyncio.to_thread(self._process.join, _END_S)
        if self._process.is_alive():
            _LOG.error("link process %s did not end within %s s; killed", self.pid, _END_S)
            self._process.kill()
            await asyncio.to_thread(self._process.join)
        self._writer.shutdown(wait=False, cancel_futures=True)
        await asyncio.to_thread(self._reader.join, _END_S)  # it sees the end of the pipe; only then may the pipe go
        with contextlib.suppress(OSError):
            self._pipe.close()
        self._process.close()


def _read(
    pipe: Connection,
    loop: asyncio.AbstractEventLoop,
    on_report: Callable[[LinkReport], None],
    on_gone: Callable[[], None],
) -> None:
    """The reader thread: until the process or the event loop is gone."""
    try:
        while True:
            loop.call_soon_threadsafe(on_report, pipe.recv())
    except (EOFError, OSError, TypeError):  # TypeError: the pipe was closed under recv
        with contextlib.suppress(RuntimeError):
            loop.call_soon_threadsafe(on_gone)
    except RuntimeError:  # the event loop is closed: there is no listener any more
        return
