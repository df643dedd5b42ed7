"""The server's settings: one TOML file, read once, strict; every number with its unit in its name."""

import math
import tomllib
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from machine.description import Machine, parse_machine_toml
from machine.field_units import unit_of
from recording.files import read_text
from recording.machine_files import shipped_machine
from server.calibration.calibration_life import CalibrationExpiry
from server.errors import SettingsError
from server.settings_camera import CameraSettings, DeviceCameraSettings, FileCameraSettings, HttpCameraSettings, Strict
from server.shown_address import without_password

# fmt: off
__all__ = [
    "CalibrationSettings", "CameraSettings", "ClosedLoopSettings", "CompensationSettings", "DeviceCameraSettings",
    "FileCameraSettings", "FoxgloveSettings", "HttpCameraSettings", "HttpSettings", "JogSettings", "LookSettings",
    "OpcUaSettings", "PlcSettings", "PositionSettings", "RecordingSettings", "ServerSettings", "read_machine",
    "read_machine_text", "read_settings",
]
# fmt: on


Port = Annotated[int, Field(ge=1, le=65535)]
LocalPort = Annotated[int, Field(ge=0, le=65535)]


class HttpSettings(Strict):
    """Address and access of the panel and the REST interface."""

    host: str = "127.0.0.1"
    port: LocalPort = 8080
    keys_file: str | None = None  # of `longreach keys`; required unless host is a loopback address
    allowed_hosts: tuple[Annotated[str, Field(min_length=1, max_length=253)], ...] = ()  # names it is reached by
    behind_proxy: bool = False  # a TLS proxy on this computer is in front: its X-Forwarded-For is believed


class PlcSettings(Strict):
    """The link to the PLC."""

    host: str = "127.0.0.1"
    port: Port = 50110
    local_host: str = "0.0.0.0"
    local_port: LocalPort = 50111
    framing: Literal["raw", "eap"] = "raw"
    pc_net_id: str = "192.168.0.10.1.1"  # EAP only: AMS NetIds of both ends
    plc_net_id: str = "192.168.0.20.1.1"
    auth_key_file: str | None = None  # hexadecimal key, the same as in the PLC; none: nothing is signed


class LookSettings(Strict):
    """Number of pairs of a look, and its limits."""

    pairs: Annotated[int, Field(ge=1, le=600)] = 20
    timeout_s: Annotated[float, Field(gt=0.0, le=120.0)] = 12.0
    spread_max_mm: Annotated[float, Field(gt=0.0, le=50.0)] = 1.0
    age_max_s: Annotated[float, Field(gt=0.0, le=600.0)] = 60.0


class PositionSettings(Strict):
    """The goal and what counts as reached."""

    tolerance_mm: Annotated[float, Field(gt=0.0, le=100.0)] = 5.0
    tolerance_deg: Annotated[float, Field(gt=0.0, le=20.0)] = 1.0
    stand_off_mm: Annotated[float, Field(ge=50.0, le=1000.0)] = 100.0
    offset_x_mm: Annotated[float, Field(ge=-300.0, le=300.0)] = 0.0
    offset_y_mm: Annotated[float, Field(ge=-300.0, le=300.0)] = 0.0
    moves_max: Annotated[int, Field(ge=1, le=10)] = 4
    closed_loop: bool = False  # permits the job `servo`: motion while looking
    local_map: Literal["rigid", "learnt"] = "learnt"
    orientation_steps_max: Annotated[int, Field(ge=0, le=5)] = 2
    wall_clearance_mm: Annotated[float, Field(ge=10.0, le=1000.0)] = 50.0
    plan_expires_s: Annotated[float, Field(gt=0.0, le=600.0)] = 60.0
    settle_timeout_s: Annotated[float, Field(gt=0.0, le=120.0)] = 15.0
    sigma_tool_mount_deg: Annotated[float, Field(gt=0.0, le=20.0)] = 2.0
    sigma_systematic_mm: Annotated[float, Field(ge=0.0, le=10.0)] = 0.2
    sigma_systematic_deg: Annotated[float, Field(ge=0.0, le=5.0)] = 0.15
    # where each of the OOI's markers hangs
    sigma_layout_mm: Annotated[float, Field(ge=0.0, le=10.0)] = 0.3
    sigma_layout_deg: Annotated[float, Field(ge=0.0, le=5.0)] = 0.1
    # scale of a print, tool and OOI each by itself: 0.3 mm of 150 mm, as a ruler shows it
    sigma_print_side_frac: Annotated[float, Field(gt=0.0, le=0.05)] = 0.002
    # what a data sheet or factory leaves; a calibration path reduces it
    sigma_focal_frac: Annotated[float, Field(gt=0.0, le=0.2)] = 0.01


class CalibrationSettings(Strict):
    """When a local calibration expires; its reasons are in `CalibrationExpiry`."""

    radius_m: Annotated[float, Field(gt=0.0, le=10.0)] = 1.0
    turn_deg: Annotated[float, Field(gt=0.0, le=180.0)] = 30.0
    joint_deg: Annotated[float, Field(gt=0.0, le=360.0)] = 60.0
    age_max_h: Annotated[float, Field(gt=0.0, le=1000.0)] = 12.0
    temperature_k: Annotated[float, Field(gt=0.0, le=200.0)] = 25.0

    def expiry(self) -> CalibrationExpiry:
        """The same in SI units."""
        turn_rad, joint_rad = math.radians(self.turn_deg), math.radians(self.joint_deg)
        return CalibrationExpiry(self.radius_m, turn_rad, joint_rad, self.age_max_h * 3600.0, self.temperature_k)


class ClosedLoopSettings(Strict):
    """Limits of closed-loop visual control: speed, distance and reliability of its looks."""

    speed_max_mm_s: Annotated[float, Field(gt=0.0, le=50.0)] = 20.0
    distance_max_mm: Annotated[float, Field(gt=0.0, le=300.0)] = 150.0
    pairs_in_a_row: Annotated[int, Field(ge=3, le=200)] = 10
    sigma_max_mm: Annotated[float, Field(gt=0.0, le=10.0)] = 1.5
    # with 25 ms of link a ramp within 200 ms; 30 ms later where the server stalls and the link stops by itself
    silence_max_ms: Annotated[float, Field(ge=30.0, le=170.0)] = 150.0
    passes_max: Annotated[int, Field(ge=1, le=5)] = 3


class JogSettings(Strict):
    """Jog, one joint or one tool axis while a button is held. A REAL machine jogs only with a passed commissioning."""

    speed_mm_s: Annotated[float, Field(gt=0.0, le=50.0)] = 30.0  # of the tool
    turn_speed_deg_s: Annotated[float, Field(gt=0.0, le=5.0)] = 2.0  # of a joint, and of the tool's turn
    commissioning_report: str | None = None  # the .json of `longreach commission`: all steps passed on this machine


class CompensationSettings(Strict):
    """A diagnosed machine whose effects are compensated; off without a file."""

    machine_file: str | None = None  # with [[effect]], as `longreach diagnose --machine-out` writes it
    diagnosis_file: str | None = None  # the answer (--json) that it comes from: undecided or outside is refused


class RecordingSettings(Strict):
    """Folder and contents of recordings."""

    folder: str = "runs"
    images: bool = True


class OpcUaSettings(Strict):
    """Read-only OPC UA interface. It has no authentication; binding to other hosts must be enabled explicitly."""

    enabled: bool = False
    host: str = "127.0.0.1"
    port: Port = 4840
    without_keys: bool = False  # every client that reaches the port may read joints, faults and the running job


class FoxgloveSettings(Strict):
    """Read-only live stream to Foxglove. It has no authentication; other hosts must be enabled explicitly."""

    enabled: bool = False
    host: str = "127.0.0.1"
    port: LocalPort = 8765
    without_keys: bool = False  # any client that reaches the port may see joints, images and the running job


class ServerSettings(Strict):
    """Everything the server needs to know before it starts."""

    machine_file: str = "hiab033"
    mode: Literal["SIM", "REAL"] = "SIM"
    http: HttpSettings = HttpSettings()
    plc: PlcSettings = PlcSettings()
    camera: CameraSettings = HttpCameraSettings()
    look: LookSettings = LookSettings()
    position: PositionSettings = PositionSettings()
    calibration: CalibrationSettings = CalibrationSettings()
    closed_loop: ClosedLoopSettings = ClosedLoopSettings()
    jog: JogSettings = JogSettings()
    compensation: CompensationSettings = CompensationSettings()
    recording: RecordingSettings = RecordingSettings()
    opcua: OpcUaSettings = OpcUaSettings()
    foxglove: FoxgloveSettings = FoxgloveSettings()


def read_settings(path: Path | None) -> ServerSettings:
    """Settings from a TOML file, or the defaults when there is none.

    Raises: SettingsError naming the field, its value, the bound and the unit.
    """
    if path is None:
        return ServerSettings()
    try:
        return ServerSettings.model_validate(tomllib.loads(read_text(path)))
    except OSError as error:
        raise SettingsError(f"settings file {path}: {error.strerror}; give a TOML file that can be read") from error
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise SettingsError(f"settings file {path} is not TOML: {error}") from error
    except ValidationError as error:
        raise SettingsError(f"settings file {path}: {first_problem(error)}") from error


def first_problem(error: ValidationError) -> str:
    """What is wrong with settings, in one line: field, value, bound, unit."""
    first = error.errors()[0]
    field = ".".join(str(part) for part in first["loc"])
    unit = unit_of(field)
    return f"{field} = {without_password(repr(first['input']))}: {first['msg']}{f' [{unit}]' if unit else ''}"


def read_machine_text(name_or_path: str) -> str:
    """Text of a shipped machine (by name, such as "hiab033") or of a machine file (by path)."""
    shipped = shipped_machine(name_or_path)
    if shipped.is_file():
        return read_text(shipped)
    try:
        return read_text(Path(name_or_path))
    except OSError as error:
        raise SettingsError(
            f"machine file '{name_or_path}': {error.strerror}; give a path or the name of a shipped machine (hiab033)"
        ) from error


def read_machine(name_or_path: str) -> Machine:
    """The nominal machine of a shipped name or a file."""
    return parse_machine_toml(read_machine_text(name_or_path))
