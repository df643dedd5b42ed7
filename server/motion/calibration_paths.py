"""Calibration paths: the paper's line-like planar one (eq. 17-19), and a folded, asymmetric, closed 3-D one."""

from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np

from machine.boards import inner_corners
from machine.chain import chain_of
from machine.description import Machine, StereoCamera
from machine.kinematics import tcp_pose
from machine.poses import inverse_pose, pose, transform_points
from machine.visibility import faces_eye, in_both_eyes, marker_in_view
from server.motion.contracts import Array, PathPlan, PlanStatus, Wall
from server.motion.joint_path import straight_poses
from server.motion.point_to_point import plan_through
from server.motion.refusal import Refusal, refused_plan, require_joints
from server.motion.settings import DEFAULT_PLAN_SETTINGS, MotionInputError, PlanSettings
from server.motion.wall_clearance import wall_refusal

#: Corners in TCP axes [m]: x up, y left, z back from the wall. 1.0 m in six legs of 14 to 20 cm, no two parallel.
FOLDED_PATH_CORNERS_M = (
    (0.13, 0.04, 0.00),
    (0.11, -0.11, 0.10),
    (-0.07, -0.09, 0.02),
    (-0.10, 0.06, 0.10),
    (0.05, 0.12, 0.08),
    (0.00, 0.00, 0.00),
)


# Whether the camera keeps the OOI in view along a path, by the nominal mount.

CORNERS_MIN = 4  # of a chess board, for a pose


def markers_in_view(
    machine: Machine, Ts_base_tcp: Array, T_base_ooi: Array, R_tcp_cam: Array, margin_px: float
) -> Array:
    """How many of the OOI's markers both eyes see from each pose; a chess board counts as one while four corners are.

    Args:    Ts_base_tcp: (m, 4, 4); T_base_ooi: as estimated (4, 4); R_tcp_cam: nominal or calibrated (3, 3).
    Returns: counts (m,).
    """
    T_tcp_cam = pose(R_tcp_cam, machine.T_tcp_cam_left[:3, 3])
    markers = machine.markers_on("ooi")
    boards = [(board.T_on_board, inner_corners(board)) for board in machine.boards_on("ooi") if board.kind == "charuco"]
    counts = np.zeros(len(Ts_base_tcp))
    for k, T_base_tcp in enumerate(Ts_base_tcp):
        T_cam_ooi = inverse_pose(T_base_tcp @ T_tcp_cam) @ T_base_ooi
        counts[k] = sum(marker_in_view(machine.camera, T_cam_ooi, marker, margin_px) for marker in markers)
        counts[k] += sum(_board_in_view(machine.camera, T_cam_ooi @ T, corners, margin_px) for T, corners in boards)
    return counts


def _board_in_view(camera: StereoCamera, T_cam_board: Array, corners: Array, margin_px: float) -> bool:
    """Whether both eyes see the printed side and enough of its corners (n, 3)."""
    points = transform_points(T_cam_board, corners)
    if not faces_eye(T_cam_board[:3, 2], points.mean(axis=0)):
        return False
    return sum(in_both_eyes(camera, points[i : i + 1], margin_px) for i in range(len(points))) >= CORNERS_MIN


@dataclass(frozen=True, slots=True)
class CalibrationPathSettings:
    """What a calibration path keeps to, and the paper's own numbers."""

    ooi_distance_min_m: float = 0.25
    scales: tuple[float, ...] = (1.0, 0.85, 0.7, 0.55, 0.45)
    view_margin_px: float = 10.0
    markers_min: int = 1
    paper_lengths_m: tuple[float, ...] = (0.12, 0.06, 0.10, 0.05, 0.14, 0.03)
    paper_xi_rad: float = float(np.pi / 4)
    paper_return: bool = True


DEFAULT_PATH_SETTINGS = CalibrationPathSettings()


def folded_corners() -> Array:
    """Corners of the folded path as offsets in TCP axes (6, 3) [m]; the last is the start again."""
    return np.array(FOLDED_PATH_CORNERS_M)


def paper_corners(path: CalibrationPathSettings = DEFAULT_PATH_SETTINGS) -> Array:
    """Corners of the paper's path as offsets in TCP axes (n, 3) [m].

    Model:   x_{i+1} = x_i + L_i cos(xi) n + L_i sin(xi) s (17-19), xi alternating between 0 and pi/4, n = x_tcp, s =
             y_tcp.
    Source:  Makinen et al. 2023, eq. 17-19; the lengths are ours, the paper gives none. The way back is a last straight
             leg.
    """
    lengths = np.array(path.paper_lengths_m)
    xi = path.paper_xi_rad * (np.arange(len(lengths)) % 2)
    steps = np.column_stack((lengths * np.cos(xi), lengths * np.sin(xi), np.zeros(len(lengths))))  # eq. 17-19
    corners = np.cumsum(steps, axis=0)
    return np.vstack((corners, np.zeros(3))) if path.paper_return else corners


def plan_calibration_path(
    machine: Machine,
    q_start: Array,
    kind: Literal["folded", "paper"] = "folded",
    settings: PlanSettings = DEFAULT_PLAN_SETTINGS,
    wall: Wall | None = None,
    T_base_ooi_estimate: Array | None = None,
    R_tcp_cam_nominal: Array | None = None,
    path: CalibrationPathSettings = DEFAULT_PATH_SETTINGS,
) -> PathPlan:
    """A calibration path from the present reference and back to it, orientation held, that keeps view, wall and limits.

    Model:   corners in TCP axes; when not feasible they are mirrored (left-right, up-down), then shrunk, until they
             are.
    Args:    q_start: present reference (joints,) [rad]; T_base_ooi_estimate: for view and distance, or None;
             R_tcp_cam_nominal: of the camera, the machine's own if None; path: margins and the paper's lengths.
    Returns: the plan; the last refusal met, at the smallest scale, when nothing is feasible.
    Raises:  MotionInputError: shapes, values that are not finite, unknown kind.
    """
    if kind not in ("folded", "paper"):
        raise MotionInputError(f"calibration path '{kind}' is unknown; give 'folded' or 'paper'")
    chain = chain_of(machine)
    q = require_joints(q_start, chain.n, "q_start")
    T_start = tcp_pose(chain, q)
    R_tcp_cam = machine.T_tcp_cam_left[:3, :3] if R_tcp_cam_nominal is None else R_tcp_cam_nominal
    corners = folded_corners() if kind == "folded" else paper_corners(path)
    refusal: Refusal | None = None
    tried = np.array([T_start])
    for scale, up, left in product(path.scales, (1.0, -1.0), (1.0, -1.0)):
        Ts = _offset_poses(T_start, scale * corners * np.array([up, left, 1.0]))
        refusal = _place_refusal(machine, T_start, Ts, wall, T_base_ooi_estimate, R_tcp_cam, path, settings)
        if refusal is None:
            plan = plan_through(machine, q, Ts, settings, wall)
            if plan.status is PlanStatus.OK:
                return plan
            refusal, tried = Refusal(plan.status, plan.reason), plan.Ts_base_tcp
    smallest = f"no calibration path fits here, mirrored or at {100 * path.scales[-1]:.0f} % of its size either: "
    status, reason = (refusal.status, refusal.reason) if refusal else (PlanStatus.INVALID, "no scale was given")
    return refused_plan(Refusal(status, smallest + reason), q, tried)


def _offset_poses(T_start: Array, offsets_tcp: Array) -> list[Array]:
    R = T_start[:3, :3]
    return [pose(R, T_start[:3, 3] + R @ offset) for offset in offsets_tcp]


def _place_refusal(
    machine: Machine,
    T_start: Array,
    Ts: list[Array],
    wall: Wall | None,
    T_base_ooi: Array | None,
    R_tcp_cam: Array,
    path: CalibrationPathSettings,
    settings: PlanSettings,
) -> Refusal | None:
    """What speaks against these corners before any joint is computed: wall, nearness to the OOI, view."""
    legs = [straight_poses(a, b, settings)[::4] for a, b in zip([T_start, *Ts[:-1]], Ts, strict=True)]
    along = np.concatenate([*legs, np.array([Ts[-1]])])
    _, too_near = wall_refusal(along, machine.T_tcp_tool, wall)
    if too_near is not None or T_base_ooi is None:
        return too_near
    markers = along[:, :3, 3] + along[:, :3, :3] @ machine.T_tcp_tool[:3, 3]
    distances = np.minimum(*(np.linalg.norm(p - T_base_ooi[:3, 3], axis=1) for p in (along[:, :3, 3], markers)))
    if distances.min() < path.ooi_distance_min_m:
        text = (
            f"tool would come as near as {1e3 * distances.min():.0f} mm from the target while calibrating, limit "
            f"{1e3 * path.ooi_distance_min_m:.0f} mm; retract first"
        )
        return Refusal(PlanStatus.WALL, text)
    seen = markers_in_view(machine, along, T_base_ooi, R_tcp_cam, path.view_margin_px)
    if seen[0] >= path.markers_min and seen.min() < path.markers_min:
        text = (
            f"camera would see {seen.min():.0f} of the OOI's markers, at least {path.markers_min} needed; "
            "start with the OOI nearer the middle of the image"
        )
        return Refusal(PlanStatus.OUT_OF_VIEW, text)
    return None
