"""What is shown over OPC UA, by browse path: the names of OPC 40010-1, our values. Pure but for reading the cell.

OPC 40010-1 1.02: MotionDeviceSystemType (MotionDevices, Controllers, SafetyStates), MotionDeviceType (Axes,
ParameterSet), AxisType (ParameterSet with ActualPosition, ActualSpeed), SafetyStateType (OperationalMode,
EmergencyStop, ProtectiveStop). Names only: no claim of conformance, and its nodes are not shipped.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from protocol.codes import FaultBit
from recording.clock import mono_ns
from server.jobs.cell import Cell
from server.jobs.service import JobService
from server.version import __version__

Value = str | bool | int | float
STALE_S = 0.25  # an older PLC state is shown with the status BadNoCommunication
SYSTEM, DEVICE, CONTROLLER, SAFETY = "MotionDeviceSystem", "MotionDevice_1", "Controller_1", "SafetyState_1"


class OperationalMode(IntEnum):
    """OperationalModeEnumeration of OPC 40010-1."""

    OTHER = 0
    MANUAL_REDUCED_SPEED = 1
    MANUAL_HIGH_SPEED = 2
    AUTOMATIC = 3
    AUTOMATIC_EXTERNAL = 4


@dataclass(frozen=True, slots=True)
class Shown:
    """One variable. `fresh` False: the PLC has not reported it for too long. `unit` is UNECE's code, or empty."""

    path: tuple[str, ...]
    value: Value
    unit: str = ""
    fresh: bool = True


def shown(service: JobService, now_ns: int | None = None) -> list[Shown]:
    """All variables at this moment; always the same paths in the same order."""
    cell = service.cell
    latest = cell.link.latest
    now_ns = mono_ns() if now_ns is None else now_ns
    fresh = latest is not None and (now_ns - latest.t_mono_ns) * 1e-9 <= STALE_S
    return [*_identity(cell), *_axes(cell, fresh), *_device(service, fresh), *_safety(cell, fresh)]


def _identity(cell: Cell) -> list[Shown]:
    device, controller = (SYSTEM, "MotionDevices", DEVICE), (SYSTEM, "Controllers", CONTROLLER)
    return [
        Shown((*device, "Manufacturer"), "longreach"),
        Shown((*device, "Model"), cell.machine.name),
        Shown((*device, "SerialNumber"), cell.machine.serial),
        Shown((*controller, "Software", "SoftwareRevision"), __version__),
    ]


def _axes(cell: Cell, fresh: bool) -> list[Shown]:
    latest, found = cell.link.latest, []
    for i, joint in enumerate(cell.machine.joints):
        axis = (SYSTEM, "MotionDevices", DEVICE, "Axes", f"Axis_{i + 1}")
        position, speed = (latest.q_rad[i], latest.qd_rad_s[i]) if latest is not None else (0.0, 0.0)
        found += [
            Shown((*axis, "AssetId"), joint.name),
            Shown((*axis, "MotionProfile"), 1),  # ROTARY
            Shown((*axis, "ParameterSet", "ActualPosition"), _degrees(position), "DD", fresh),
            Shown((*axis, "ParameterSet", "ActualSpeed"), _degrees(speed), "E96", fresh),
        ]
    return found


def _device(service: JobService, fresh: bool) -> list[Shown]:
    latest, job = service.cell.link.latest, service.engine.current
    running = job is not None and not job.ended
    parameters = (SYSTEM, "MotionDevices", DEVICE, "ParameterSet")
    tasks = (SYSTEM, "Controllers", CONTROLLER, "TaskControls", "TaskControl_1", "ParameterSet")
    return [
        Shown((*parameters, "InControl"), latest is not None and latest.plc_state == "RUN", "", fresh),
        Shown((*parameters, "OnPath"), latest is not None and latest.plc_state == "RUN", "", fresh),
        Shown((*tasks, "TaskProgramLoaded"), running),
        Shown((*tasks, "TaskProgramName"), job.kind if job is not None and running else ""),
    ]


def _safety(cell: Cell, fresh: bool) -> list[Shown]:
    """Shown for information: no safety function reads it (the emergency stop is hardware)."""
    latest, phase = cell.link.latest, cell.link.health.phase.value
    bits = FaultBit(latest.fault_bits) if latest is not None else FaultBit(0)
    parameters = (SYSTEM, "SafetyStates", SAFETY, "ParameterSet")
    mode = OperationalMode.OTHER if phase == "local" else OperationalMode.AUTOMATIC_EXTERNAL
    return [
        Shown((*parameters, "EmergencyStop"), FaultBit.ESTOP in bits, "", fresh),
        Shown((*parameters, "OperationalMode"), int(mode)),
        Shown((*parameters, "ProtectiveStop"), bool(bits & ~FaultBit.ESTOP), "", fresh),
    ]


def _degrees(radians: float) -> float:
    return round(float(np.rad2deg(radians)), 4)
