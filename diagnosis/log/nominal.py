"""The nominal machine as a diagnosis needs it: only what is there is used, and what is absent is named."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from diagnosis.errors import DiagnosisError
from diagnosis.log.findings import Finding
from diagnosis.log.machine_keys import (
    DH_KEYS,
    JOINT_LIMIT_KEYS,
    STEREO_CAMERA_KEYS,
    TABLES,
    VALVE_KEYS,
    limits_of_other_kind,
    unknown_keys,
)
from diagnosis.log.machine_numbers import flag_of, is_sliding, list_of, number_of, pose_of, table_of, vector_of
from diagnosis.log.machine_targets import TrackedPoint, markers_of, points_of
from diagnosis.log.urdf_arm import MISSING_MASS_CONSEQUENCE, urdf_arm
from diagnosis.log.urdf_files import UrdfFiles
from machine.description import StereoCamera
from machine.effects.arm import Arm, DhRow, arm_from_dh
from machine.effects.dynamics import Actuators
from machine.effects.entries import EffectEntry, parse_entries
from machine.errors import MachineError
from machine.remainder import Remainder, parse_remainders
from machine.rotations import Array
from machine.targets import Marker

CYCLE_TIME_KEYS = ("cycle_s", "log_cycle_s")
CAMERA_MOUNT_KEY = "T_tcp_cam_left"


@dataclass(frozen=True, slots=True)
class SensorAccuracy:
    """Standard deviations that data sheets state: of a tracker's points in motion and at rest [m], of marker corners
    [px], of encoders [rad], of a marker's place among those on one object [m]; None where the file says nothing.
    """

    tracker_m: float | None = None
    static_m: float | None = None
    corners_px: float | None = None
    encoders_rad: float | None = None
    layout_m: float | None = None


@dataclass(frozen=True, slots=True)
class Nominal:
    """A machine file, as far as it goes. `missing_part_reasons`: what each missing part would have needed, by part.

    `q_min`, `q_max`: (n,) [rad], -inf and inf where not given. `actuators` without kp holds 0 there: stage controller
    is then absent. `joint_slides` (n,): whose rad are m. `baseline_effects`: they belong to this machine before
    anything is wrong with it. `findings`: what in the file is odd, and nothing of it fatal.
    """

    name: str
    joint_names: tuple[str, ...]
    q_min: Array
    q_max: Array
    arm: Arm | None
    actuators: Actuators | None
    has_controller: bool
    camera: StereoCamera | None
    T_tcp_cam_left: Array | None
    T_tcp_tool: Array | None
    T_base_tracker: Array | None
    markers: tuple[Marker, ...]
    tracked_points: tuple[TrackedPoint, ...]
    baseline_effects: tuple[EffectEntry, ...]
    missing_part_reasons: tuple[tuple[str, str], ...]
    baseline_remainders: tuple[Remainder, ...] = ()
    serial_number: str = ""
    joint_slides: tuple[bool, ...] = ()
    findings: tuple[Finding, ...] = ()
    sensor_accuracy: SensorAccuracy = SensorAccuracy()

    def baseline_remainder(self, stage: str, joint: int | None = None, on: str = "") -> Remainder | None:
        """What the baseline leaves of one stage; None where the file says nothing."""
        return next((r for r in self.baseline_remainders if (r.stage, r.joint, r.on) == (stage, joint, on)), None)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    def why_absent(self, part: str) -> str:
        """What is missing for a part; empty when nothing is."""
        return "; ".join(text for name, text in self.missing_part_reasons if name == part)


def nominal_of(text: str, urdfs: UrdfFiles | None = None, n_joints: int | None = None) -> Nominal:
    """The nominal machine that a machine.toml text describes.

    Args:    urdfs: where the URDF that [urdf] names may lie. n_joints: of the recording, for files without [[joint]].
    Raises:  DiagnosisError: not TOML, or a field that is there is wrong; names field, value and what belongs there.
    """
    try:
        tables = tomllib.loads(text.removeprefix("\ufeff"))
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise DiagnosisError(f"machine.toml is not TOML: {error}") from error
    try:
        return _Reader(tables, urdfs or UrdfFiles(), n_joints).nominal()
    except MachineError as error:
        raise DiagnosisError(f"machine.toml: {error}") from error


class _Reader:
    """Collects what is absent, and what is odd, while the sections are read."""

    def __init__(self, tables: dict[str, Any], urdfs: UrdfFiles, n_joints: int | None) -> None:
        self._tables = tables
        self._urdfs = urdfs
        self._joints = [table_of(section, f"joint {k}") for k, section in enumerate(list_of(tables, "joint"), start=1)]
        self._slides = [is_sliding(joint, f"joint {k}") for k, joint in enumerate(self._joints, start=1)]
        self._count = n_joints
        self._absent: list[tuple[str, str]] = []
        self._findings: list[Finding] = unknown_keys(tables)
        self._urdf_limits = np.zeros((0, 2))

    def nominal(self) -> Nominal:
        machine, tool, camera, tracker = (
            self._section_table(name) for name in ("machine", "tool", "camera", "tracker")
        )
        gravity = vector_of(machine, "gravity_base_m_s2", 3, "[machine]")
        arm, names = self._arm_and_joint_names(np.array([0.0, 0.0, -9.81]) if gravity is None else gravity)
        sliding = self._sliding_flags(arm, len(names))
        limits = [self._joint_limits(k, sliding[k]) for k in range(len(names))]
        self._findings += limits_of_other_kind(self._joints, sliding)
        actuators = self._parse_actuators()
        weighed = arm is not None and float(arm.mass.sum()) > 0.0
        if actuators is not None and weighed and not np.isfinite(limits).all():
            self._absent.append(("load", self._unlimited_joints_text(limits, sliding)))
        has_controller = actuators is not None and self._has_controller_gains(actuators)
        eyes, markers = self._camera(camera), self._markers(tool)
        return Nominal(
            name=str(machine.get("name", "")),
            joint_names=names,
            q_min=np.array([low for low, _ in limits]),
            q_max=np.array([high for _, high in limits]),
            arm=arm,
            actuators=actuators,
            has_controller=has_controller,
            camera=eyes,
            T_tcp_cam_left=pose_of(camera, CAMERA_MOUNT_KEY, "[camera]"),
            T_tcp_tool=pose_of(tool, "T_tcp_tool", "[tool]"),
            T_base_tracker=pose_of(tracker, "T_base_tracker", "[tracker]"),
            markers=markers,
            tracked_points=points_of(self._tables, len(names)),
            baseline_effects=parse_entries(self._tables.get("effect"), max(len(names), 1)),
            missing_part_reasons=tuple(self._absent),
            baseline_remainders=parse_remainders(self._tables.get("remainder")),
            serial_number=str(machine.get("serial", "")),
            joint_slides=sliding,
            findings=tuple(self._findings),
            sensor_accuracy=self._sensor_accuracy(),
        )

    def _sensor_accuracy(self) -> SensorAccuracy:
        """What [sensors] states. Raises: DiagnosisError: an accuracy that is not above 0."""
        section = self._section_table("sensors")
        stated = {key: number_of(section, key, "[sensors]") for key in TABLES["sensors"]}
        for key, value in stated.items():
            if value is not None and value <= 0.0:
                raise DiagnosisError(f"machine.toml: [sensors] {key} = {value:g}; give a standard deviation above 0")
        return SensorAccuracy(**stated)

    def _section_table(self, name: str) -> dict[str, Any]:
        return table_of(self._tables.get(name, {}), f"[{name}]")

    def _sliding_flags(self, arm: Arm | None, n: int) -> tuple[bool, ...]:
        """As the arm has them; a joint that is not on its chain, as its type says."""
        written = [k < len(self._slides) and self._slides[k] for k in range(n)]
        if arm is None:
            return tuple(written)
        return tuple(bool(arm.prismatic[k]) if arm.motion_factor[k] else written[k] for k in range(n))

    def _is_missing(self, part: str, needed: tuple[str, ...]) -> bool:
        """Whether a field is missing in some joint; all missing fields of the first such joint are written down."""
        if not self._joints:
            self._absent.append((part, f"no [[joint]] with {', '.join(needed)}"))
            return True
        for number, joint in enumerate(self._joints, start=1):
            missing = [field for field in needed if field not in joint]
            if missing:
                self._absent.append((part, f"joint {number} ({joint.get('name', '?')}) has no {', '.join(missing)}"))
                return True
        return False

    def _names(self) -> tuple[str, ...]:
        if self._joints:
            return tuple(str(joint.get("name", f"joint{k}")) for k, joint in enumerate(self._joints, start=1))
        return tuple(f"joint{k}" for k in range(1, (self._count or 0) + 1))

    def _arm_and_joint_names(self, gravity: Array) -> tuple[Arm | None, tuple[str, ...]]:
        names, tool = self._names(), pose_of(self._section_table("tool"), "T_flange_tcp", "[tool]")
        if "urdf" in self._tables:
            return self._urdf_arm(names, tool, gravity)
        if self._is_missing("structure", DH_KEYS):
            return None, names
        rows = [_dh_row(joint, f"joint {k} ({names[k - 1]})") for k, joint in enumerate(self._joints, start=1)]
        mass = np.array(
            [number_of(joint, "mass_kg", name) or 0.0 for joint, name in zip(self._joints, names, strict=True)]
        )
        com = [vector_of(joint, "com_m", 3, name) for joint, name in zip(self._joints, names, strict=True)]
        if any("mass_kg" not in joint for joint in self._joints):
            self._absent.append(("load", f"some joint has no mass_kg: {MISSING_MASS_CONSEQUENCE}"))
        centres = np.array([np.zeros(3) if centre is None else centre for centre in com])
        return arm_from_dh(rows, tool, mass, centres, gravity), names

    def _urdf_arm(
        self, names: tuple[str, ...], tool: Array | None, gravity: Array
    ) -> tuple[Arm | None, tuple[str, ...]]:
        section = self._section_table("urdf")
        missing = [key for key in ("file", "base_link", "tip_link") if not isinstance(section.get(key), str)]
        if missing:
            raise DiagnosisError(
                f"machine.toml: [urdf] {', '.join(missing)} missing or no text; give file, base_link, tip_link"
            )
        text = self._urdfs.urdf_text(section["file"])
        if text is None:
            self._absent.append(("structure", self._urdfs.why_none(section["file"])))
            return None, names
        found = urdf_arm(text, section, self._joints, tool, gravity)
        self._findings += found.findings
        self._urdf_limits = found.joint_limits
        if found.load_absent:
            self._absent.append(("load", found.load_absent))
        return found.arm, found.joint_names

    def _unlimited_joints_text(self, limits: list[tuple[float, float]], sliding: tuple[bool, ...]) -> str:
        """What it costs that some joints have no limits."""
        unlimited = [k for k, ends in enumerate(limits) if not np.isfinite(ends).all()]
        wanted = " or ".join(sorted({" and ".join(JOINT_LIMIT_KEYS[sliding[k]]) for k in unlimited}))
        which = f"joint{'s' if len(unlimited) > 1 else ''} {', '.join(str(k + 1) for k in unlimited)}"
        text = f"{which}: no {wanted}; the range that the recording shows stands in for it"
        return f"{text}, and sizes of internal_leakage and load_droop go by the largest load in that range"

    def _joint_limits(self, k: int, sliding: bool) -> tuple[float, float]:
        """Of a [[joint]], each end that it does not give as the URDF has it; else without end."""
        low, high = self._urdf_limits[k].tolist() if k < len(self._urdf_limits) else (-np.inf, np.inf)
        joint, where = self._joints[k] if k < len(self._joints) else {}, f"joint {k + 1}"
        scale, unit = (1.0, "m") if sliding else (float(np.pi / 180.0), "deg")
        given = [number_of(joint, key, where) for key in JOINT_LIMIT_KEYS[sliding]]
        low, high = (end if own is None else scale * own for end, own in zip((low, high), given, strict=True))
        if low >= high:
            ends = f"q_min_{unit} = {low / scale:g} is not below q_max_{unit} = {high / scale:g}"
            raise DiagnosisError(f"machine.toml: {where}: {ends}{'' if None not in given else ' of the URDF'}")
        return low, high

    def _parse_actuators(self) -> Actuators | None:
        plc = self._section_table("plc")
        missing = [field for field in CYCLE_TIME_KEYS if field not in plc]
        if missing:
            self._absent.append(("actuator", f"[plc] has no {', '.join(missing)}"))
            return None
        if self._is_missing("actuator", VALVE_KEYS):
            return None
        rows = []
        for k, joint in enumerate(self._joints, start=1):
            values = [
                number_of(joint, field, f"joint {k}") or 0.0 for field in (*VALVE_KEYS, "kp_frac_per_rad", "pt1_tau_s")
            ]
            rows.append((values[0], 2.0 * np.pi * values[1], *values[2:]))
        cycle, log_cycle = (number_of(plc, field, "[plc]") or 0.0 for field in CYCLE_TIME_KEYS)
        return Actuators(np.array(rows), cycle, log_cycle, number_of(plc, "transport_delay_s", "[plc]") or 0.0)

    def _has_controller_gains(self, actuators: Actuators) -> bool:
        """Whether every joint has a gain above 0."""
        if self._is_missing("controller", ("kp_frac_per_rad",)):
            return False
        idle = [k for k, kp in enumerate(actuators.joints[:, 3], start=1) if kp == 0.0]
        if idle:
            self._absent.append(("controller", f"joint {idle[0]} has kp_frac_per_rad = 0: nothing controls it"))
        return not idle

    def _camera(self, section: Mapping[str, Any]) -> StereoCamera | None:
        missing = [field for field in (*STEREO_CAMERA_KEYS, CAMERA_MOUNT_KEY) if field not in section]
        if missing:
            self._absent.append(("camera", f"[camera] has no {', '.join(missing)}"))
        if set(missing) - {CAMERA_MOUNT_KEY}:
            return None
        values = {field: cast(float, number_of(section, field, "[camera]")) for field in STEREO_CAMERA_KEYS}
        given = vector_of(section, "distortion", 5, "[camera]")
        rectified = flag_of(section, "rectified", "[camera]", True)
        lens = np.zeros(5) if given is None or rectified else given  # corners of a rectified image carry no distortion
        return StereoCamera(
            width_px=int(values["width_px"]),
            height_px=int(values["height_px"]),
            fx_px=values["fx_px"],
            fy_px=values["fy_px"],
            cx_px=values["cx_px"],
            cy_px=values["cy_px"],
            distortion=(float(lens[0]), float(lens[1]), float(lens[2]), float(lens[3]), float(lens[4])),
            baseline_m=values["baseline_m"],
            rate_hz=number_of(section, "rate_hz", "[camera]") or 0.0,
            rectified=rectified,
        )

    def _markers(self, tool: Mapping[str, Any]) -> tuple[Marker, ...]:
        found = markers_of(self._tables)
        if not found:
            self._absent.append(("camera", "no [[markers.marker]]"))
        if "T_tcp_tool" not in tool and any(marker.on == "tool" for marker in found):
            self._absent.append(("camera", "[tool] has no T_tcp_tool: the markers on the tool are not used"))
        hung = "T_tcp_tool" in tool or CAMERA_MOUNT_KEY in self._section_table("camera")
        if hung and "T_flange_tcp" not in tool and "urdf" not in self._tables:  # a URDF's tip is its tcp
            self._absent.append(("camera", "[tool] has no T_flange_tcp: the tcp is taken to be the last link's frame"))
        return found


def _dh_row(joint: Mapping[str, Any], where: str) -> DhRow:
    a, d, alpha, theta = (cast(float, number_of(joint, field, where)) for field in DH_KEYS)
    convention = joint.get("dh_convention")
    if convention not in ("classic", "modified"):
        raise DiagnosisError(f"machine.toml: {where}: dh_convention = {convention!r}; give 'classic' or 'modified'")
    return DhRow(a, d, float(np.deg2rad(alpha)), float(np.deg2rad(theta)), is_sliding(joint, where), convention)
