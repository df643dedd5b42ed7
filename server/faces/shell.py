"""What the faces share: where they may listen, the library of their extra, and their life within the server."""

import asyncio
import importlib
import logging
from collections.abc import AsyncIterator, Coroutine
from contextlib import asynccontextmanager
from typing import Any

from server.access.hosts import is_loopback
from server.errors import SettingsError
from server.settings import FoxgloveSettings, OpcUaSettings

log = logging.getLogger(__name__)


def require_own_computer(table: str, settings: FoxgloveSettings | OpcUaSettings, subject: str) -> None:
    """Raises: SettingsError: reachable from other computers without leave."""
    if not is_loopback(settings.host) and not settings.without_keys:
        raise SettingsError(
            f"[{table}] host = '{settings.host}' is reachable from other computers, and {subject} requires no key: "
            f"listen on 127.0.0.1, or set [{table}] without_keys = true"
        )


def extra(table: str, module: str, package: str) -> Any:
    """The library of an extra. Raises: SettingsError: it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise SettingsError(
            f"[{table}] enabled = true, and {package} is not installed: pip install 'longreach[{table}]'"
        ) from error


@asynccontextmanager
async def running(name: str, run: Coroutine[Any, Any, None], at_its_end: str) -> AsyncIterator[None]:
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
