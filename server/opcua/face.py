"""The OPC UA server itself: an address space made once, values written into it five times a second, nothing taken."""

import asyncio
import importlib
import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from datetime import UTC, datetime
from typing import Any

from server.access.hosts import is_loopback
from server.errors import SettingsError
from server.jobs.service import JobService
from server.opcua.values import Shown, shown
from server.settings import OpcUaSettings

log = logging.getLogger(__name__)
NAMESPACE = "urn:longreach:robotics"  # the names are those of http://opcfoundation.org/UA/Robotics/, the nodes our own
PERIOD_S = 0.2
STOP_S = 3.0
SPACE = "asyncua.server.standard_address_space.standard_address_space"  # 9 MB of source, seconds to import


class OpcUaFace:
    """Belongs to the event loop."""

    def __init__(self, service: JobService, host: str, port: int) -> None:
        self._service, self._endpoint = service, f"opc.tcp://{host}:{port}/longreach/"
        self._library = load_library()
        self._ua = self._library.ua
        self._server: Any = None
        self._nodes: dict[tuple[str, ...], Any] = {}

    async def start(self) -> None:
        """Listen. Raises: SettingsError: the port is taken."""
        server = self._server = self._library.Server()
        await server.init()
        server.set_endpoint(self._endpoint)
        server.set_server_name("longreach")
        server.set_security_policy([self._ua.SecurityPolicyType.NoSecurity])
        index = await server.register_namespace(NAMESPACE)
        for variable in shown(self._service):
            await self._add(index, variable)
        try:
            await server.start()
        except OSError as error:
            raise SettingsError(f"[opcua] {self._endpoint}: {error.strerror or error}; choose another port") from error

    async def run(self) -> None:
        """Write values until cancelled."""
        while True:
            for variable in shown(self._service):
                await self._nodes[variable.path].write_value(self._data(variable))
            await asyncio.sleep(PERIOD_S)

    async def stop(self) -> None:
        """Stop listening."""
        if self._server is not None:
            async with asyncio.timeout(STOP_S):
                await self._server.stop()

    async def _add(self, index: int, one: Shown) -> None:
        parent = self._server.nodes.objects
        for depth in range(1, len(one.path)):
            known = self._nodes.get(one.path[:depth])
            if known is None:
                known = await parent.add_object(index, one.path[depth - 1])
                self._nodes[one.path[:depth]] = known
            parent = known
        node = await parent.add_variable(index, one.path[-1], one.value, varianttype=self._kind(one))
        if one.unit:
            await node.add_property(index, "EngineeringUnits", one.unit)
        self._nodes[one.path] = node

    def _kind(self, one: Shown) -> Any:
        kinds = self._ua.VariantType
        by_type = {str: kinds.String, bool: kinds.Boolean, int: kinds.Int32, float: kinds.Double}
        return by_type[type(one.value)]

    def _data(self, one: Shown) -> Any:
        """With the status that says whether it is to be believed."""
        status = self._ua.StatusCodes.Good if one.fresh else self._ua.StatusCodes.BadNoCommunication
        variant = self._ua.Variant(one.value, self._kind(one))
        now = datetime.now(UTC)
        return self._ua.DataValue(variant, self._ua.StatusCode(status), SourceTimestamp=now, ServerTimestamp=now)


def check_opcua(settings: OpcUaSettings) -> None:
    """Whether it can be as the settings want it; loads the library if so, before any event loop has to wait for it.

    Raises: SettingsError: no library, or reachable from other computers without leave.
    """
    if settings.enabled and not is_loopback(settings.host) and not settings.without_keys:
        raise SettingsError(
            f"[opcua] host = '{settings.host}' is reachable from other computers, and OPC UA requires no key: "
            "listen on 127.0.0.1, or set [opcua] without_keys = true"
        )
    if settings.enabled:
        load_library()


def load_library() -> Any:
    """asyncua, with the address space that it would else import in the event loop at its start.

    Raises: SettingsError: it is not installed.
    """
    try:
        library = importlib.import_module("asyncua")
    except ImportError as error:
        raise SettingsError(
            "[opcua] enabled = true, and asyncua is not installed: pip install 'longreach[opcua]'"
        ) from error
    with suppress(ImportError):  # a version that keeps it elsewhere is only slower to start
        importlib.import_module(SPACE)
    return library


@asynccontextmanager
async def opcua_face(service: JobService, settings: OpcUaSettings) -> AsyncIterator[OpcUaFace | None]:
    """Inside it the face is up, if it is wanted. Raises: SettingsError: it is wanted and cannot be."""
    if not settings.enabled:
        yield None
        return
    await asyncio.to_thread(load_library)  # already there when the settings were checked
    face = OpcUaFace(service, settings.host, settings.port)
    await face.start()
    running = asyncio.create_task(face.run(), name="opcua")
    running.add_done_callback(_log_end)
    try:
        yield face
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)
        await face.stop()


def _log_end(done: "asyncio.Task[None]") -> None:
    """A face that ends by itself is a defect; the machine goes on without it, and its clients see old time stamps."""
    if not done.cancelled() and (error := done.exception()) is not None:
        log.error("opcua: values are no longer updated", exc_info=error)
