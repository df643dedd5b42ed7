"""The nominal machine as a diagnosis needs it: only what is there is used, and what is absent is named."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from diagnosis.errors import DiagnosisError
from diagnosis.log.machine_numbers import number_of, pose_of, vector_of
from machine.description import StereoCamera
from machine.effects.arm import Arm, DhRow, arm_from_dh
from machine.effects.arm_urdf import arm_from_urdf
from machine.effects.dynamics import Actuators
from machine.effects.entries import EffectEntry, parse_entries
from machine.errors import MachineError
from machine.remainder import Remainder, parse_remainders
from machine.rotations import Array
from machine.targets import Marker

GEOMETRY = ("a_m", "d_m", "alpha_deg", "theta_offset_deg")
VALVE = ("velocity_gain_rad_s", "valve_frequency_hz", "valve_damping")
TIMES = ("cycle_s", "log_cycle_s")
EYES = ("width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px", "baseline_m")


@dataclass(frozen=True, slots=True)
class TrackedPoint:
    """A point fixed to link `joint` (0: the base), in that link's frame (3,) [m]; None: to be found from the data."""

    name: str
    joint: int
    xyz_m: tuple[float, float, float] | None


@dataclass(frozen=True, slots=True)
class Nominal:
    """A machine file, as far as it goes. `absent`: what each missing part would have needed, by part.

    `q_min`, `q_max`: (n,) [rad], -inf and inf where not given. `actuators` without kp holds 0 there: stage controller
    is then absent. `sliding`: joints that slide (n,), whose rad are m. `baseline`: effects that belong to this machine
    before anything is wrong with it.
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
    points: tuple[TrackedPoint, ...]
    baseline: tuple[EffectEntry, ...]
    absent: tuple[tuple[str, str], ...]
    remainders: tuple[Remainder, ...] = ()
    serial: str = ""
    sliding: tuple[bool, ...] = ()

    def remainder(self, stage: str, joint: int | None = None, on: str = "") -> Remainder | None:
        """What the baseline leaves of one stage; None where the file says nothing."""
        return next((r for r in self.remainders if (r.stage, r.joint, r.on) == (stage, joint, on)), None)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    def why_absent(self, part: str) -> str:
        """What is missing for a part; empty when nothing is."""
        return "; ".join(text for name, text in self.absent if name == part)


def nominal_of(text: str, urdf: str | None = None, n_joints: int | None = None) -> Nominal:
    """The nominal machine that a machine.toml text describes.

    Args:    urdf: text of the URDF that [urdf] names. n_joints: of the recording, for files without [[joint]].
    Raises:  DiagnosisError: not TOML, or a field that is there is wrong; names field, value and what belongs there.
    """
    try:
        tables = tomllib.loads(text.removeprefix("\ufeff"))
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise DiagnosisError(f"machine.toml is not TOML: {error}") from error
    try:
        return _Reader(tables, urdf, n_joints).nominal()
    except MachineError as error:
        raise DiagnosisError(f"machine.toml: {error}") from error


class _Reader:
    """Collects what is absent while the sections are read."""

    def __init__(self, tables: dict[str, Any], urdf: str | None, n_joints: int | None) -> None:
        self._tables = tables
        self._urdf = urdf
        self._joints = [_table(one, f"joint {k}") for k, one in enumerate(_list(tables, "joint"), start=1)]
        self._count = n_joints
        self._absent: list[tuple[str, str]] = []

    def nominal(self) -> Nominal:
        machine = _table(self._tables.get("machine", {}), "[machine]")
        gravity = vector_of(machine, "gravity_base_m_s2", 3, "[machine]")
        arm, names = self._arm(np.array([0.0, 0.0, -9.81]) if gravity is None else gravity)
        limits = [self._limits(k) for k in range(len(names))]
        tool = _table(self._tables.get("tool", {}), "[tool]")
        camera = _table(self._tables.get("camera", {}), "[camera]")
        tracker = _table(self._tables.get("tracker", {}), "[tracker]")
        actuators = self._actuators()
        weighed = arm is not None and float(arm.mass.sum()) > 0.0
        if actuators is not None and weighed and not np.isfinite(limits).all():
            self._absent.append(("load", self._unlimited(limits)))
        return Nominal(
            name=str(machine.get("name", "")),
            joint_names=names,
            q_min=np.array([low for low, _ in limits]),
            q_max=np.array([high for _, high in limits]),
            arm=arm,
            actuators=actuators,
            has_controller=actuators is not None and self._controlled(actuators),
            camera=self._camera(camera),
            T_tcp_cam_left=pose_of(camera, "T_tcp_cam_left", "[camera]"),
            T_tcp_tool=pose_of(tool, "T_tcp_tool", "[tool]"),
            T_base_tracker=pose_of(tracker, "T_base_tracker", "[tracker]"),
            markers=self._markers(),
            points=self._points(len(names)),
            baseline=parse_entries(self._tables.get("effect"), max(len(names), 1)),
            absent=tuple(self._absent),
            remainders=parse_remainders(self._tables.get("remainder")),
            serial=str(machine.get("serial", "")),
            sliding=self._sliding(arm, len(names)),
        )

    def _sliding(self, arm: Arm | None, n: int) -> tuple[bool, ...]:
        if arm is not None:
            return tuple(bool(x) for x in arm.prismatic)
        return tuple(k < len(self._joints) and self._joints[k].get("type") == "prismatic" for k in range(n))

    def _lack(self, part: str, needed: tuple[str, ...]) -> bool:
        """Whether some joint lacks a field; all that the first such joint lacks is written down."""
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

    def _arm(self, gravity: Array) -> tuple[Arm | None, tuple[str, ...]]:
        names = self._names()
        tool = pose_of(_table(self._tables.get("tool", {}), "[tool]"), "T_flange_tcp", "[tool]")
        if "urdf" in self._tables:
            return self._urdf_arm(names, tool)
        if self._lack("structure", GEOMETRY):
            return None, names
        rows = [_dh_row(joint, f"joint {k} ({names[k - 1]})") for k, joint in enumerate(self._joints, start=1)]
        mass = np.array(
            [number_of(joint, "mass_kg", name) or 0.0 for joint, name in zip(self._joints, names, strict=True)]
        )
        com = [vector_of(joint, "com_m", 3, name) for joint, name in zip(self._joints, names, strict=True)]
        if any("mass_kg" not in joint for joint in self._joints):
            text = "some joint has no mass_kg: gravity's torque is not known; a bend is told as an encoder's error"
            self._absent.append(("load", text))
        centres = np.array([np.zeros(3) if one is None else one for one in com])
        return arm_from_dh(rows, tool, mass, centres, gravity), names

    def _urdf_arm(self, names: tuple[str, ...], tool: Array | None) -> tuple[Arm | None, tuple[str, ...]]:
        section = _table(self._tables["urdf"], "[urdf]")
        missing = [key for key in ("file", "base_link", "tip_link") if not isinstance(section.get(key), str)]
        if missing:
            raise DiagnosisError(
                f"machine.toml: [urdf] {', '.join(missing)} missing or no text; give file, base_link, tip_link"
            )
        if self._urdf is None:
            self._absent.append(("structure", f"the URDF {section['file']!r} is not in the recording; put it beside"))
            return None, names
        named = bool(self._joints) and all("name" in joint for joint in self._joints)
        wanted = names if named else None
        return arm_from_urdf(self._urdf, section["base_link"], section["tip_link"], wanted, tool)

    def _unlimited(self, limits: list[tuple[float, float]]) -> str:
        """What it costs that some joints have no limits."""
        lacking = [k for k, ends in enumerate(limits) if not np.isfinite(ends).all()]
        keys = {"m" if k < len(self._joints) and self._joints[k].get("type") == "prismatic" else "deg" for k in lacking}
        wanted = " or ".join(f"q_min_{unit} and q_max_{unit}" for unit in sorted(keys))
        which = f"joint{'s' if len(lacking) > 1 else ''} {', '.join(str(k + 1) for k in lacking)}"
        text = f"{which}: no {wanted}; the range that the recording shows stands in for it"
        return f"{text}, and sizes of internal_leakage and load_droop go by the largest load in that range"

    def _limits(self, k: int) -> tuple[float, float]:
        if k >= len(self._joints):
            return -np.inf, np.inf
        joint, ends = self._joints[k], (-np.inf, np.inf)
        where = f"joint {k + 1}"
        scale, unit = (1.0, "m") if joint.get("type") == "prismatic" else (float(np.pi / 180.0), "deg")
        low, high = (number_of(joint, f"{name}_{unit}", where) for name in ("q_min", "q_max"))
        if low is not None and high is not None and low >= high:
            raise DiagnosisError(f"machine.toml: {where}: q_min_{unit} = {low:g} is not below q_max_{unit} = {high:g}")
        return (ends[0] if low is None else low * scale, ends[1] if high is None else high * scale)

    def _actuators(self) -> Actuators | None:
        plc = _table(self._tables.get("plc", {}), "[plc]")
        missing = [field for field in TIMES if field not in plc]
        if missing:
            self._absent.append(("actuator", f"[plc] has no {', '.join(missing)}"))
            return None
        if self._lack("actuator", VALVE):
            return None
        rows = []
        for k, joint in enumerate(self._joints, start=1):
            values = [
                number_of(joint, field, f"joint {k}") or 0.0 for field in (*VALVE, "kp_frac_per_rad", "pt1_tau_s")
            ]
            rows.append((values[0], 2.0 * np.pi * values[1], *values[2:]))
        cycle, log_cycle = (number_of(plc, field, "[plc]") or 0.0 for field in TIMES)
        return Actuators(np.array(rows), cycle, log_cycle, number_of(plc, "transport_delay_s", "[plc]") or 0.0)

    def _controlled(self, actuators: Actuators) -> bool:
        """Whether every joint has a gain above 0."""
        if self._lack("controller", ("kp_frac_per_rad",)):
            return False
        idle = [k for k, kp in enumerate(actuators.joints[:, 3], start=1) if kp == 0.0]
        if idle:
            self._absent.append(("controller", f"joint {idle[0]} has kp_frac_per_rad = 0: nothing controls it"))
        return not idle

    def _camera(self, section: Mapping[str, Any]) -> StereoCamera | None:
        missing = [field for field in EYES if field not in section]
        if missing:
            self._absent.append(("camera", f"[camera] has no {', '.join(missing)}"))
            return None
        values = {field: cast(float, number_of(section, field, "[camera]")) for field in EYES}
        given = vector_of(section, "distortion", 5, "[camera]")
        rectified = bool(section.get("rectified", True))
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

    def _markers(self) -> tuple[Marker, ...]:
        section = _table(self._tables.get("markers", {}), "[markers]")
        found = []
        for k, one in enumerate(_list(section, "marker"), start=1):
            where = f"markers.marker {k}"
            table = _table(one, where)
            side, T, on = number_of(table, "side_m", where), pose_of(table, "T_on_marker", where), table.get("on")
            if side is None or T is None or on not in ("tool", "ooi") or not isinstance(table.get("id"), int):
                raise DiagnosisError(f"machine.toml: {where} needs id, side_m, on ('tool' or 'ooi') and T_on_marker")
            found.append(Marker(table["id"], side, on, T))
        if not found:
            self._absent.append(("camera", "no [[markers.marker]]"))
        return tuple(found)

    def _points(self, n: int) -> tuple[TrackedPoint, ...]:
        found = []
        for name, one in _table(self._tables.get("points", {}), "[points]").items():
            table = _table(one, f"points.{name}")
            joint, xyz = table.get("joint"), vector_of(table, "xyz_m", 3, f"points.{name}")
            if isinstance(joint, bool) or not isinstance(joint, int) or not 0 <= joint <= n:
                raise DiagnosisError(
                    f"machine.toml: points.{name} needs joint = 0 .. {n}, and xyz_m = [x, y, z] if known"
                )
            at = None if xyz is None else (float(xyz[0]), float(xyz[1]), float(xyz[2]))
            found.append(TrackedPoint(name, joint, at))
        return tuple(found)


def _dh_row(joint: Mapping[str, Any], where: str) -> DhRow:
    a, d, alpha, theta = (cast(float, number_of(joint, field, where)) for field in GEOMETRY)
    kind, convention = joint.get("type", "revolute"), joint.get("dh_convention")
    if kind not in ("revolute", "prismatic") or convention not in ("classic", "modified"):
        raise DiagnosisError(
            f"machine.toml: {where}: type = {kind!r}, dh_convention = {convention!r}; give 'revolute' or 'prismatic', "
            "and 'classic' or 'modified'"
        )
    return DhRow(a, d, float(np.deg2rad(alpha)), float(np.deg2rad(theta)), kind == "prismatic", convention)


def _table(value: Any, where: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise DiagnosisError(f"machine.toml: {where} = {value!r} is not a table")
    return value


def _list(table: Mapping[str, Any], key: str) -> list[Any]:
    value = table.get(key, [])
    if not isinstance(value, list):
        raise DiagnosisError(f"machine.toml: {key} is not a list; write [[{key}]]")
    return value
