"""The OPC UA server itself: an address space made once, values written into it five times a second, nothing taken."""

import asyncio
import importlib
import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import IntEnum
from typing import Any

import numpy as np

from protocol.codes import FaultBit
from recording.clock import mono_ns
from server.errors import SettingsError
from server.faces.shell import FACE_CONNECTIONS_MAX, import_extra, require_own_computer, running_face
from server.jobs.cell import Cell
from server.jobs.service import JobService
from server.settings import OpcUaSettings
from server.version import __version__

# What is shown over OPC UA, by browse path: the names of OPC 40010-1, our values. Pure but for reading the cell.

Value = str | bool | int | float
PLC_STATE_AGE_MAX_S = 0.25  # an older PLC state is shown with the status BadNoCommunication
SYSTEM, DEVICE, CONTROLLER, SAFETY = "MotionDeviceSystem", "MotionDevice_1", "Controller_1", "SafetyState_1"


class OperationalMode(IntEnum):
    """OperationalModeEnumeration of OPC 40010-1."""

    OTHER = 0
    MANUAL_REDUCED_SPEED = 1
    MANUAL_HIGH_SPEED = 2
    AUTOMATIC = 3
    AUTOMATIC_EXTERNAL = 4


@dataclass(frozen=True, slots=True)
class OpcUaValue:
    """One variable. `is_fresh` False: the PLC has not reported it for too long. The unit's code is UNECE's."""

    browse_path: tuple[str, ...]
    value: Value
    unece_unit_code: str = ""
    is_fresh: bool = True


def opcua_values(service: JobService, now_ns: int | None = None) -> list[OpcUaValue]:
    """All variables at this moment; always the same paths in the same order."""
    cell = service.cell
    latest = cell.link.latest
    now_ns = mono_ns() if now_ns is None else now_ns
    fresh = latest is not None and (now_ns - latest.t_mono_ns) * 1e-9 <= PLC_STATE_AGE_MAX_S
    return [
        *_identity_values(cell),
        *_axis_values(cell, fresh),
        *_device_values(service, fresh),
        *_safety_values(cell, fresh),
    ]


def _identity_values(cell: Cell) -> list[OpcUaValue]:
    device, controller = (SYSTEM, "MotionDevices", DEVICE), (SYSTEM, "Controllers", CONTROLLER)
    return [
        OpcUaValue((*device, "Manufacturer"), "longreach"),
        OpcUaValue((*device, "Model"), cell.machine.name),
        OpcUaValue((*device, "SerialNumber"), cell.machine.serial),
        OpcUaValue((*controller, "Software", "SoftwareRevision"), __version__),
    ]


def _axis_values(cell: Cell, fresh: bool) -> list[OpcUaValue]:
    latest, found = cell.link.latest, []
    for i, joint in enumerate(cell.machine.joints):
        axis = (SYSTEM, "MotionDevices", DEVICE, "Axes", f"Axis_{i + 1}")
        position, speed = (latest.q_rad[i], latest.qd_rad_s[i]) if latest is not None else (0.0, 0.0)
        found += [
            OpcUaValue((*axis, "AssetId"), joint.name),
            OpcUaValue((*axis, "MotionProfile"), 1),  # ROTARY
            OpcUaValue((*axis, "ParameterSet", "ActualPosition"), _rounded_degrees(position), "DD", fresh),
            OpcUaValue((*axis, "ParameterSet", "ActualSpeed"), _rounded_degrees(speed), "E96", fresh),
        ]
    return found


def _device_values(service: JobService, fresh: bool) -> list[OpcUaValue]:
    latest, job = service.cell.link.latest, service.engine.current
    running = job is not None and not job.has_ended
    parameters = (SYSTEM, "MotionDevices", DEVICE, "ParameterSet")
    tasks = (SYSTEM, "Controllers", CONTROLLER, "TaskControls", "TaskControl_1", "ParameterSet")
    return [
        OpcUaValue((*parameters, "InControl"), latest is not None and latest.plc_state == "RUN", "", fresh),
        OpcUaValue((*parameters, "OnPath"), latest is not None and latest.plc_state == "RUN", "", fresh),
        OpcUaValue((*tasks, "TaskProgramLoaded"), running),
        OpcUaValue((*tasks, "TaskProgramName"), job.kind if job is not None and running else ""),
    ]


def _safety_values(cell: Cell, fresh: bool) -> list[OpcUaValue]:
    """Shown for information: no safety function reads it (the emergency stop is hardware)."""
    latest, phase = cell.link.latest, cell.link.health.phase.value
    bits = FaultBit(latest.fault_bits) if latest is not None else FaultBit(0)
    parameters = (SYSTEM, "SafetyStates", SAFETY, "ParameterSet")
    mode = OperationalMode.OTHER if phase == "local" else OperationalMode.AUTOMATIC_EXTERNAL
    return [
        OpcUaValue((*parameters, "EmergencyStop"), FaultBit.ESTOP in bits, "", fresh),
        OpcUaValue((*parameters, "OperationalMode"), int(mode)),
        OpcUaValue((*parameters, "ProtectiveStop"), bool(bits & ~FaultBit.ESTOP), "", fresh),
    ]


def _rounded_degrees(radians: float) -> float:
    return round(float(np.rad2deg(radians)), 4)


# The names are those of http://opcfoundation.org/UA/Robotics/, the nodes our own
OPCUA_NAMESPACE_URI = "urn:longreach:robotics"
ASYNCUA_CONNECTION_LOGGER_NAME = "asyncua.server.binary_server_asyncio"
OPCUA_UPDATE_PERIOD_S = 0.2
OPCUA_STOP_TIMEOUT_S = 3.0
# 9 MB of source, seconds to import
ASYNCUA_ADDRESS_SPACE_MODULE = "asyncua.server.standard_address_space.standard_address_space"


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
        server.iserver.max_connections = (
            FACE_CONNECTIONS_MAX  # each takes a descriptor, and one must be left for a STOP
        )
        server.set_endpoint(self._endpoint)
        server.set_server_name("longreach")
        server.set_security_policy([self._ua.SecurityPolicyType.NoSecurity])
        index = await server.register_namespace(OPCUA_NAMESPACE_URI)
        for variable in opcua_values(self._service):
            await self._add(index, variable)
        try:
            await server.start()
        except OSError as error:
            raise SettingsError(f"[opcua] {self._endpoint}: {error.strerror or error}; choose another port") from error

    async def run(self) -> None:
        """Write values until cancelled."""
        while True:
            for variable in opcua_values(self._service):
                await self._nodes[variable.browse_path].write_value(self._data_value(variable))
            await asyncio.sleep(OPCUA_UPDATE_PERIOD_S)

    async def stop(self) -> None:
        """Stop listening."""
        if self._server is not None:
            async with asyncio.timeout(OPCUA_STOP_TIMEOUT_S):
                await self._server.stop()

    async def _add(self, index: int, one: OpcUaValue) -> None:
        parent = self._server.nodes.objects
        for depth in range(1, len(one.browse_path)):
            known = self._nodes.get(one.browse_path[:depth])
            if known is None:
                known = await parent.add_object(index, one.browse_path[depth - 1])
                self._nodes[one.browse_path[:depth]] = known
            parent = known
        node = await parent.add_variable(index, one.browse_path[-1], one.value, varianttype=self._variant_type(one))
        if one.unece_unit_code:
            await node.add_property(index, "EngineeringUnits", one.unece_unit_code)
        self._nodes[one.browse_path] = node

    def _variant_type(self, one: OpcUaValue) -> Any:
        kinds = self._ua.VariantType
        by_type = {str: kinds.String, bool: kinds.Boolean, int: kinds.Int32, float: kinds.Double}
        return by_type[type(one.value)]

    def _data_value(self, one: OpcUaValue) -> Any:
        """With the status that says whether it is to be believed."""
        status = self._ua.StatusCodes.Good if one.is_fresh else self._ua.StatusCodes.BadNoCommunication
        variant = self._ua.Variant(one.value, self._variant_type(one))
        now = datetime.now(UTC)
        return self._ua.DataValue(variant, self._ua.StatusCode(status), SourceTimestamp=now, ServerTimestamp=now)


def check_opcua(settings: OpcUaSettings) -> None:
    """Whether it can be as the settings want it; loads the library if so, before any event loop has to wait for it.

    Raises: SettingsError: no library, or reachable from other computers without leave.
    """
    if settings.enabled:
        require_own_computer("opcua", settings, "OPC UA")
        load_library()


def load_library() -> Any:
    """asyncua, with the address space that it would else import in the event loop at its start.

    Raises: SettingsError: it is not installed.
    """
    library = import_extra("opcua", "asyncua", "asyncua")
    logging.getLogger(ASYNCUA_CONNECTION_LOGGER_NAME).setLevel(
        logging.ERROR
    )  # a warning for each refused connection would flood the log
    with suppress(ImportError):  # a version that keeps it elsewhere is only slower to start
        importlib.import_module(ASYNCUA_ADDRESS_SPACE_MODULE)
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
    try:
        async with running_face(
            "opcua", face.run(), "opcua: values are no longer updated"
        ):  # clients see old time stamps
            yield face
    finally:
        await face.stop()
