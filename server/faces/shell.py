"""What the faces share: where they may listen, the library of their extra, and their life within the server."""

import asyncio
import importlib
import logging
import os
import resource
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from typing import Any

from server.access.hosts import is_loopback
from server.errors import SettingsError
from server.settings import FoxgloveSettings, OpcUaSettings

log = logging.getLogger(__name__)
SPARE_DESCRIPTORS_MIN = 128  # descriptors that no face may take: two turns in which HTTP accepts
FACE_RESTART_DELAY_S = 30.0
FACE_CONNECTIONS_MAX = 32  # of a face that can be limited by number


def require_own_computer(table: str, settings: FoxgloveSettings | OpcUaSettings, subject: str) -> None:
    """Raises: SettingsError: reachable from other computers without leave."""
    if not is_loopback(settings.host) and not settings.without_keys:
        raise SettingsError(
            f"[{table}] host = '{settings.host}' is reachable from other computers, and {subject} requires no key: "
            f"listen on 127.0.0.1, or set [{table}] without_keys = true"
        )


def import_extra(table: str, module: str, package: str) -> Any:
    """The library of an extra. Raises: SettingsError: it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise SettingsError(
            f"[{table}] enabled = true, and {package} is not installed: pip install 'longreach[{table}]'"
        ) from error


def descriptors_are_short() -> bool:
    """Whether so few are left that HTTP, within its own limit of connections, could be without one for a STOP."""
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    try:
        used = len(os.listdir("/proc/self/fd"))
    except FileNotFoundError:  # not Linux: it cannot be known
        return False
    except OSError:  # listing takes one itself
        return True
    return limit != resource.RLIM_INFINITY and used > limit - min(SPARE_DESCRIPTORS_MIN, limit // 4)


def set_aside() -> list[int]:
    """Descriptors that are held so that connections of a face cannot have them. Raises: OSError: none is left."""
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    count = (
        SPARE_DESCRIPTORS_MIN // 2 if limit == resource.RLIM_INFINITY else min(SPARE_DESCRIPTORS_MIN // 2, limit // 4)
    )
    return [os.open(os.devnull, os.O_RDONLY) for _ in range(count)]


async def give_way(name: str, stop: Callable[[], None], start: Callable[[], None]) -> None:
    """Close a face, with all its connections, for a while where it takes the descriptors that a STOP needs."""
    if not descriptors_are_short():
        return
    log.error(
        "%s: closed for %.0f s: its connections use up the descriptors; raise 'ulimit -n'", name, FACE_RESTART_DELAY_S
    )
    await asyncio.to_thread(stop)
    while True:
        await asyncio.sleep(FACE_RESTART_DELAY_S)
        if descriptors_are_short():
            continue
        try:
            return start()
        except SettingsError as error:  # its port is held by connections that do not end
            log.error("%s", error)


@asynccontextmanager
async def running_face(name: str, run: Coroutine[Any, Any, None], at_its_end: str) -> AsyncIterator[None]:
    """Inside it the face runs. One that ends by itself is a defect: it is logged, and the server goes on without it."""

    def report(task: "asyncio.Task[None]") -> None:
        if not task.cancelled() and (error := task.exception()) is not None:
            log.error("%s", at_its_end, exc_info=error)

    task = asyncio.create_task(run, name=name)
    task.add_done_callback(report)
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
