"""The machine as its file describes it: frozen dataclasses, and the strict reader of machine.toml text.

Reading the file itself is a shell's work; here is only text -> `Machine`.
"""

import tomllib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError

from machine.boards import board_markers
from machine.errors import MachineFileError
from machine.field_units import unit_of
from machine.lens import PRINCIPAL_OFFSET_MAX_FRAC, distorted_radius_max, principal_off_frac
from machine.marker_sections import (
    MARKER_FIELD_REMEDIES,
    BoardSection,
    MarkerSection,
    MarkersSection,
    Pose16,
    Strict,
    check_markers,
)
from machine.remainder import Remainder, parse_baseline, parse_remainders
from machine.rotations import Array
from machine.targets import Board, Marker

if TYPE_CHECKING:
    from machine.effects.entries import EffectEntry

SHOWN_VALUE_CHARS_MAX = 120  # characters of a wrong value in a message
TARGET_OFFSET_MAX_M = 20.0  # of a marker or board on its object


@dataclass(frozen=True, slots=True)
class Joint:
    """One actuated joint: classic DH row, limits, and the nominal velocity actuator and controller. SI units."""

    name: str
    a_m: float
    d_m: float
    alpha_rad: float
    theta_offset_rad: float
    q_min_rad: float
    q_max_rad: float
    qd_max_rad_s: float
    qdd_max_rad_s2: float
    velocity_gain_rad_s: float
    valve_frequency_hz: float
    valve_damping: float
    kp_frac_per_rad: float
    pt1_tau_s: float
    mass_kg: float
    com_m: tuple[float, float, float]
    encoder_counts_rev: int
    park_rad: float | None = None  # where it goes to park; None: it stays where it is


@dataclass(frozen=True, slots=True)
class StereoCamera:
    """Two parallel pinhole eyes with one lens model; OpenCV axes and pixel centres (top left pixel centre is 0, 0)."""

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, float, float, float, float]  # k1, k2, p1, p2, k3
    baseline_m: float
    rate_hz: float
    rectified: bool

    @property
    def matrix(self) -> Array:
        """Camera matrix (3, 3) [px]."""
        return np.array([[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, slots=True)
class Machine:
    """The whole nominal machine. Joints from the base; `T_flange_tcp` is link 7 of the paper's Table 1."""

    name: str
    gravity_base_m_s2: Array
    tcp_speed_max_m_s: float
    joints: tuple[Joint, ...]
    T_flange_tcp: Array
    T_tcp_tool: Array
    camera: StereoCamera
    T_tcp_cam_left: Array
    dictionary: str
    markers: tuple[Marker, ...]
    plc_cycle_s: float
    plc_log_cycle_s: float
    transport_delay_s: float
    boards: tuple[Board, ...] = ()
    effects: "tuple[EffectEntry, ...]" = ()  # the machine's baseline
    remainders: tuple[Remainder, ...] = ()
    serial: str = ""  # distinguishes machines of one name in a fleet; not interpreted

    def markers_on(self, on: Literal["tool", "ooi"]) -> tuple[Marker, ...]:
        """The markers that sit on one object."""
        return tuple(marker for marker in self.markers if marker.on == on)

    def boards_on(self, on: Literal["tool", "ooi"]) -> tuple[Board, ...]:
        """The boards that sit on one object."""
        return tuple(board for board in self.boards if board.on == on)


def _read_only_array(values: object, shape: tuple[int, ...]) -> Array:
    array = np.array(values, dtype=float).reshape(shape)
    array.setflags(write=False)
    return array


Vector3 = Annotated[list[float], Field(min_length=3, max_length=3)]
Positive = Annotated[float, Field(gt=0.0)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]  # joints name channels and URDF elements


class _MachineSection(Strict):
    name: Annotated[str, Field(min_length=1, max_length=80)]
    serial: Annotated[str, Field(max_length=80, pattern=r"^[^\x00-\x1f\x7f]*$")] = ""
    gravity_base_m_s2: Vector3 = Field(default_factory=lambda: [0.0, 0.0, -9.81])
    tcp_speed_max_m_s: Annotated[float, Field(gt=0.0, le=2.0)] = 0.15


class _JointSection(Strict):
    name: Name
    type: Literal["revolute"]
    dh_convention: Literal["classic"]
    a_m: Annotated[float, Field(ge=-20.0, le=20.0)]
    d_m: Annotated[float, Field(ge=-20.0, le=20.0)]
    alpha_deg: Annotated[float, Field(ge=-180.0, le=180.0)]
    theta_offset_deg: Annotated[float, Field(ge=-360.0, le=360.0)]
    q_min_deg: Annotated[float, Field(ge=-360.0, le=360.0)]
    q_max_deg: Annotated[float, Field(ge=-360.0, le=360.0)]
    qd_max_deg_s: Positive
    qdd_max_deg_s2: Positive
    velocity_gain_rad_s: Positive
    valve_frequency_hz: Positive
    valve_damping: Positive
    kp_frac_per_rad: Positive
    pt1_tau_s: Annotated[float, Field(ge=0.0, le=10.0)] = 0.0
    mass_kg: Annotated[float, Field(ge=0.0)] = 0.0
    com_m: Vector3 = Field(default_factory=lambda: [0.0, 0.0, 0.0])
    encoder_counts_rev: Annotated[int, Field(gt=0)] = 262144
    park_deg: float | None = None


class _ToolSection(Strict):
    T_flange_tcp: Pose16
    T_tcp_tool: Pose16


class _CameraSection(Strict):
    width_px: Annotated[int, Field(gt=0, le=8192)]
    height_px: Annotated[int, Field(gt=0, le=8192)]
    fx_px: Positive
    fy_px: Positive
    cx_px: float
    cy_px: float
    distortion: Annotated[list[float], Field(min_length=5, max_length=5)] = [0.0] * 5
    baseline_m: Positive
    rate_hz: Positive
    rectified: bool
    off_centre: bool = False  # confirms a principal point far from the middle, as a cropped picture has
    T_tcp_cam_left: Pose16


class _PlcSection(Strict):
    cycle_s: Positive
    log_cycle_s: Positive
    transport_delay_s: Annotated[float, Field(ge=0.0)] = 0.0


class _MachineFile(Strict):
    machine: _MachineSection
    joint: Annotated[list[_JointSection], Field(min_length=1, max_length=8)]
    tool: _ToolSection
    camera: _CameraSection
    markers: MarkersSection
    plc: _PlcSection
    effect: list[dict[str, Any]] | None = None  # read by machine.effects.entries
    remainder: list[dict[str, Any]] | None = None  # read by machine.remainder
    points: dict[str, Any] | None = None  # of a tracker; the diagnosis reads them
    tracker: dict[str, Any] | None = None


def _joint_from_section(section: _JointSection) -> Joint:
    if section.q_min_deg >= section.q_max_deg:
        raise MachineFileError(
            f"joint '{section.name}': q_min_deg = {section.q_min_deg} "
            f"must be below q_max_deg = {section.q_max_deg} [deg]"
        )
    park_deg = section.park_deg
    if park_deg is not None and not section.q_min_deg <= park_deg <= section.q_max_deg:
        raise MachineFileError(
            f"joint '{section.name}': park_deg = {park_deg} must lie inside its range, "
            f"{section.q_min_deg} .. {section.q_max_deg} [deg]"
        )
    rad = np.deg2rad
    return Joint(
        name=section.name,
        a_m=section.a_m,
        d_m=section.d_m,
        alpha_rad=float(rad(section.alpha_deg)),
        theta_offset_rad=float(rad(section.theta_offset_deg)),
        q_min_rad=float(rad(section.q_min_deg)),
        q_max_rad=float(rad(section.q_max_deg)),
        qd_max_rad_s=float(rad(section.qd_max_deg_s)),
        qdd_max_rad_s2=float(rad(section.qdd_max_deg_s2)),
        velocity_gain_rad_s=section.velocity_gain_rad_s,
        valve_frequency_hz=section.valve_frequency_hz,
        valve_damping=section.valve_damping,
        kp_frac_per_rad=section.kp_frac_per_rad,
        pt1_tau_s=section.pt1_tau_s,
        mass_kg=section.mass_kg,
        com_m=(section.com_m[0], section.com_m[1], section.com_m[2]),
        encoder_counts_rev=section.encoder_counts_rev,
        park_rad=None if park_deg is None else float(rad(park_deg)),
    )


def _checked_pose(values: list[float], subject: str) -> Array:
    T = _read_only_array(values, (4, 4))
    rotation = T[:3, :3]
    error = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if error > 1e-6 or np.linalg.det(rotation) < 0 or not np.allclose(T[3], [0, 0, 0, 1]):
        raise MachineFileError(
            f"{subject} is not a pose: its rotation departs from orthonormal by {error:.2e} (limit 1e-6) "
            "or is mirrored; give 16 numbers, row by row"
        )
    return T


def _checked_pose_on_object(values: list[float], subject: str) -> Array:
    """Pose of a marker or board on its object; far-off places are millimetres written as metres."""
    T = _checked_pose(values, subject)
    away = float(np.abs(T[:3, 3]).max())
    if away > TARGET_OFFSET_MAX_M:
        raise MachineFileError(
            f"{subject} lies {away:g} from the origin (limit {TARGET_OFFSET_MAX_M:g} [m]); give metres"
        )
    return T


def _marker_from_section(section: MarkerSection) -> Marker:
    T = _checked_pose_on_object(section.T_on_marker, f"marker {section.id}: T_on_marker")
    return Marker(marker_id=section.id, side_m=section.side_m, on=section.on, T_on_marker=T)


def board_of(section: BoardSection) -> Board:
    """The board of a section. Raises: MachineFileError: its place is not a pose, or too far away."""
    return Board(
        kind=section.kind,
        on=section.on,
        squares_x=section.squares_x,
        squares_y=section.squares_y,
        square_m=section.square_m,
        marker_m=section.marker_m,
        first_id=section.first_id,
        legacy_pattern=section.legacy_pattern,
        T_on_board=_checked_pose_on_object(section.T_on_board, f"board of first_id {section.first_id}: T_on_board"),
    )


def grid_markers(boards: tuple[Board, ...]) -> tuple[Marker, ...]:
    """Every marker of the grids: for the measurement they are markers like all others."""
    return tuple(marker for board in boards if board.kind == "grid" for marker in board_markers(board))


def _camera_from_section(section: _CameraSection) -> StereoCamera:
    # a rectified image carries no distortion, whatever the raw one's was
    k1, k2, p1, p2, k3 = (0.0,) * 5 if section.rectified else section.distortion
    camera = StereoCamera(
        width_px=section.width_px,
        height_px=section.height_px,
        fx_px=section.fx_px,
        fy_px=section.fy_px,
        cx_px=section.cx_px,
        cy_px=section.cy_px,
        distortion=(k1, k2, p1, p2, k3),
        baseline_m=section.baseline_m,
        rate_hz=section.rate_hz,
        rectified=section.rectified,
    )
    _check_lens(camera, section.off_centre)
    return camera


def _check_lens(camera: StereoCamera, off_centre: bool) -> None:
    """Refuse a principal point outside the image or far from its middle, and a lens that folds back inside it."""
    for name, value, size in (("cx", camera.cx_px, camera.width_px), ("cy", camera.cy_px, camera.height_px)):
        if not 0.0 <= value <= size - 1.0:
            raise MachineFileError(f"camera.{name}_px = {value} must lie inside the image, 0 .. {size - 1} [px]")
    off_frac = principal_off_frac((camera.cx_px, camera.cy_px), (camera.width_px, camera.height_px))
    if off_frac > PRINCIPAL_OFFSET_MAX_FRAC and not off_centre:
        raise MachineFileError(
            f"camera: principal point ({camera.cx_px:g}, {camera.cy_px:g}) px lies {100 * off_frac:.0f} % of the image "
            f"from its middle (limit {100 * PRINCIPAL_OFFSET_MAX_FRAC:g} %); give the calibration of this image size, "
            "or confirm a cropped picture with off_centre = true"
        )
    x = max(camera.cx_px, camera.width_px - 1.0 - camera.cx_px) / camera.fx_px
    y = max(camera.cy_px, camera.height_px - 1.0 - camera.cy_px) / camera.fy_px
    corner, limit = float(np.hypot(x, y)), distorted_radius_max(camera.distortion)
    if corner >= limit:
        raise MachineFileError(
            f"camera.distortion = {list(camera.distortion)} folds back at {limit:.3f} focal lengths from the axis, but "
            f"the image's corner is at {corner:.3f}; calibrate the lens with marks out to the corners"
        )


def _first_error(error: ValidationError, sections: dict[str, object]) -> str:
    """Field, value and bound of a file's first fault; a joint or a marker also by its own name."""
    first = error.errors()[0]
    names, part = [], sections
    for key in first["loc"]:
        part = _child_at_key(part, key)
        label = part.get("name", part.get("id")) if isinstance(part, dict) else None
        names.append(f"{key} ({label})" if isinstance(key, int) and label is not None else str(key))
    field = names[-1] if names else "file"
    given = repr(first["input"])
    given = given if len(given) <= SHOWN_VALUE_CHARS_MAX else f"{given[: SHOWN_VALUE_CHARS_MAX - 4]} ..."
    value = "" if first["type"] in ("missing", "model_type", "value_error") else f" = {given}"
    unit = f" [{unit_of(field)}]" if unit_of(field) else ""
    remedy = f"; {MARKER_FIELD_REMEDIES[field]}" if names[:1] == ["markers"] and field in MARKER_FIELD_REMEDIES else ""
    return f"{'.'.join(names)}{value}: {first['msg'].removeprefix('Value error, ')}{unit}{remedy}"


def _child_at_key(part: object, key: int | str) -> object:
    if isinstance(part, dict):
        return part.get(key)
    return part[key] if isinstance(part, list) and isinstance(key, int) and key < len(part) else None


def parse_machine_toml(text: str) -> Machine:
    """The machine that a machine.toml text describes.

    Raises: MachineFileError naming the field, its value and the bound.
    """
    try:
        tables = tomllib.loads(text.removeprefix("\ufeff"))  # Windows' editors write a byte order mark
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise MachineFileError(f"machine file is not TOML: {error}") from error
    try:
        sections = _MachineFile.model_validate(tables)
    except ValidationError as error:
        raise MachineFileError(f"machine file: {_first_error(error, tables)}") from error
    names = [joint.name for joint in sections.joint]
    if len(set(names)) != len(names):
        raise MachineFileError(f"joint: names {names} repeat; every joint needs a name of its own")
    check_markers(sections.markers)
    boards = tuple(board_of(section) for section in sections.markers.board)
    return Machine(
        name=sections.machine.name,
        serial=sections.machine.serial,
        gravity_base_m_s2=_read_only_array(sections.machine.gravity_base_m_s2, (3,)),
        tcp_speed_max_m_s=sections.machine.tcp_speed_max_m_s,
        joints=tuple(_joint_from_section(section) for section in sections.joint),
        T_flange_tcp=_checked_pose(sections.tool.T_flange_tcp, "tool.T_flange_tcp"),
        T_tcp_tool=_checked_pose(sections.tool.T_tcp_tool, "tool.T_tcp_tool"),
        camera=_camera_from_section(sections.camera),
        T_tcp_cam_left=_checked_pose(sections.camera.T_tcp_cam_left, "camera.T_tcp_cam_left"),
        dictionary=sections.markers.dictionary,
        markers=tuple(_marker_from_section(section) for section in sections.markers.marker) + grid_markers(boards),
        boards=boards,
        plc_cycle_s=sections.plc.cycle_s,
        plc_log_cycle_s=sections.plc.log_cycle_s,
        transport_delay_s=sections.plc.transport_delay_s,
        effects=parse_baseline(sections.effect, len(sections.joint)),
        remainders=parse_remainders(sections.remainder),
    )
