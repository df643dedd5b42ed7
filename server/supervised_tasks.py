"""Loops that must go on while the server runs: one that ends is logged, reported as a fault, and started again."""

import asyncio
import logging
from collections.abc import Awaitable, Callable

from recording.clock import mono_s

log = logging.getLogger(__name__)
FIRST_S, MAX_S = 0.1, 2.0  # back-off: a defect at every start must not fill the log, nor leave a gap of minutes
FAILURE_REPORT_DURATION_S = 10.0  # after so long without another failure it is no longer reported

Loop = Callable[[], Awaitable[None]]


async def whole_in_thread(work: Callable[[], None]) -> None:
    """As asyncio.to_thread; cancelled, it waits for the end first, so that what was started can be ended."""
    done = asyncio.ensure_future(asyncio.to_thread(work))
    try:
        await asyncio.shield(done)
    except asyncio.CancelledError:
        await asyncio.wait({done})
        raise


class SupervisedTasks:
    """Belongs to one event loop."""

    def __init__(self) -> None:
        self._tasks: list[asyncio.Task[None]] = []
        self._failed: dict[str, tuple[float, str]] = {}

    @property
    def recent_failure(self) -> str:
        """Which of them failed within the last FAILURE_REPORT_DURATION_S, and how; empty when all is well."""
        since_s = mono_s() - FAILURE_REPORT_DURATION_S
        return "; ".join(text for failed_s, text in self._failed.values() if failed_s > since_s)

    def start(self, name: str, loop: Loop, on_failure: Loop | None = None) -> None:
        """Run `loop` until `close`. `on_failure` comes after each failure, before the next start."""
        self._tasks.append(asyncio.create_task(self._keep_running(name, loop, on_failure), name=name))

    async def close(self) -> None:
        """End all of them."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self._tasks.clear()

    async def _keep_running(self, name: str, loop: Loop, on_failure: Loop | None) -> None:
        wait_s = FIRST_S
        while True:
            begun_s = mono_s()
            why = await _run_until_ended(name, loop)
            ended_s = mono_s()
            self._failed[name] = ended_s, f"{name} failed ({why}) and was restarted; see the server's log"
            if on_failure is not None:
                await _run_until_ended(f"what follows a failure of {name}", on_failure)
            wait_s = FIRST_S if ended_s - begun_s > FAILURE_REPORT_DURATION_S else wait_s
            await asyncio.sleep(wait_s)
            wait_s = min(2.0 * wait_s, MAX_S)


async def _run_until_ended(name: str, loop: Loop) -> str:
    """Run it; why it ended. Only our own cancellation goes through."""
    try:
        await loop()
    except asyncio.CancelledError:
        task = asyncio.current_task()
        if task is None or task.cancelling():
            raise
        log.exception("%s was cancelled from within", name)
        return "cancelled from within"
    except Exception as error:  # the outermost loop of a part of the server
        log.exception("%s failed", name)
        return type(error).__name__
    return "it returned"
