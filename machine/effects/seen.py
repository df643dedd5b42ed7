"""Simulated measurements of camera, odometry and tracker for a machine with effects, vectorised over samples."""

from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from machine.description import StereoCamera
from machine.effects.layout import (
    CLOCK_OFFSET,
    CLOCK_RATE_PPM,
    CLOCK_ZERO,
    FOCAL,
    HAND_EYE_ROTATION,
    HAND_EYE_TRANSLATION,
    K1,
    LATENCY,
    MARKER_SIZE,
    PRINCIPAL,
    READOUT,
    STAMP_ROW,
    STEREO,
    TOOL_MARKER_ROTATION,
    TOOL_MARKER_TRANSLATION,
    ParameterSets,
)
from machine.errors import MachineError
from machine.lens import fold_radius
from machine.markers import marker_corners
from machine.rotations import Array, rotation_from_rotvec
from machine.targets import Marker

DEPTH_MIN_M = 1e-6  # at or behind the eye: NaN


def true_times(sets: ParameterSets, t_camera_s: Array, t_start_s: float, which: int = 0) -> Array:
    """When images with these stamps were really exposed, on the PLC's clock (m,) [s].

    Model: t_camera = t_true + offset + rate (t_true - t_start - zero) + latency; identity at neutral.
    Args:  t_camera_s: stamps mapped by the best known offset (m,) [s]. t_start_s: start of the recording [s].
    """
    G = sets.machine_parameters[which]
    t_zero_s = t_start_s + G[CLOCK_ZERO]
    rate = 1e-6 * G[CLOCK_RATE_PPM]
    stamps = np.asarray(t_camera_s, dtype=float)
    return (stamps - G[CLOCK_OFFSET] - G[LATENCY] + rate * t_zero_s) / (1.0 + rate)


def camera_mount(sets: ParameterSets, T_tcp_cam_left: Array, which: int = 0) -> Array:
    """True T_tcp_cam_left (4, 4): turned about its own axes, moved along the tcp's."""
    G = sets.machine_parameters[which]
    T = np.array(T_tcp_cam_left, dtype=float)
    if np.any(G[HAND_EYE_ROTATION]):
        T[:3, :3] = T[:3, :3] @ rotation_from_rotvec(G[HAND_EYE_ROTATION])
    T[:3, 3] += G[HAND_EYE_TRANSLATION]
    return T


def tool_place(sets: ParameterSets, T_tcp_tool: Array, which: int = 0) -> Array:
    """T_tcp_tool (4, 4) as the tool's markers show it: turned and moved in the tool's own frame."""
    G = sets.machine_parameters[which]
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_from_rotvec(G[TOOL_MARKER_ROTATION]), G[TOOL_MARKER_TRANSLATION]
    return np.asarray(T_tcp_tool @ T, dtype=float)


def true_camera(sets: ParameterSets, camera: StereoCamera, which: int = 0) -> StereoCamera:
    """The camera as it is: focal lengths, principal point, first radial coefficient."""
    G = sets.machine_parameters[which]
    k1, k2, p1, p2, k3 = camera.distortion
    return replace(
        camera,
        fx_px=float(camera.fx_px * (1.0 + G[FOCAL])),
        fy_px=float(camera.fy_px * (1.0 + G[FOCAL])),
        cx_px=float(camera.cx_px + G[PRINCIPAL][0]),
        cy_px=float(camera.cy_px + G[PRINCIPAL][1]),
        distortion=(float(k1 + G[K1]), k2, p1, p2, k3),
    )


@dataclass(frozen=True, slots=True)
class Corners:
    """Corners of each marker in each sample, (m, markers, 4, 2) by eye; NaN behind it, and beyond its lens."""

    left_px: Array
    right_px: Array


def marker_points(sets: ParameterSets, markers: tuple[Marker, ...], which: int = 0) -> Array:
    """True corners on the object (markers, 4, 3) [m]."""
    size = 1.0 + sets.machine_parameters[which, MARKER_SIZE]
    points = [
        marker_corners(marker.side_m * size) @ marker.T_on_marker[:3, :3].T + marker.T_on_marker[:3, 3]
        for marker in markers
    ]
    return np.array(points).reshape(len(markers), 4, 3)


def seen_corners(
    sets: ParameterSets,
    camera: StereoCamera,
    markers: tuple[Marker, ...],
    Ts_cam_object: Array,
    Ts_cam_object_later: Array | None = None,
    dt_s: float = 0.0,
    which: int = 0,
) -> Corners:
    """What both eyes see of an object's markers.

    Model:   pinhole with the true lens; the right eye turned by the misalignment; each corner moves on by its own speed
             times (row / last row - 1/2 + stamp_row / 2) readout, the speed from a second set of poses dt_s later.
    Args:    Ts_cam_object, Ts_cam_object_later: (m, 4, 4), the object in the left eye's frame. dt_s: [s], above 0 with
             later poses. Without them the shutter has no effect.
    Raises:  MachineError: wrong shapes.
    """
    poses = np.asarray(Ts_cam_object, dtype=float)
    if poses.ndim != 3 or poses.shape[1:] != (4, 4) or not markers:
        raise MachineError(
            f"object poses have shape {poses.shape} with {len(markers)} markers; give (m, 4, 4), 1 or more"
        )
    lens, points = true_camera(sets, camera, which), marker_points(sets, markers, which)
    left, right = _both_eyes(sets, lens, poses, points, which)
    readout = float(sets.machine_parameters[which, READOUT])
    if readout == 0.0 or Ts_cam_object_later is None:
        return Corners(left, right)
    if not dt_s > 0.0:
        raise MachineError(f"later poses are {dt_s} s later; give a time above 0 s")
    later = _both_eyes(sets, lens, np.asarray(Ts_cam_object_later, dtype=float), points, which)
    return Corners(
        *(
            _rolling_shutter_pixels(
                now, two, camera.height_px, readout / dt_s, float(sets.machine_parameters[which, STAMP_ROW])
            )
            for now, two in zip((left, right), later, strict=True)
        )
    )


def _rolling_shutter_pixels(
    pixels: Array, later: Array, height_px: int, readout_over_dt: float, stamp_row: float
) -> Array:
    row = pixels[..., 1:] / (height_px - 1.0) - 0.5 + 0.5 * stamp_row
    return pixels + (later - pixels) * row * readout_over_dt


def _both_eyes(sets: ParameterSets, lens: StereoCamera, poses: Array, points: Array, which: int) -> tuple[Array, Array]:
    turn = sets.machine_parameters[which, STEREO]
    R_left_right = rotation_from_rotvec(turn) if np.any(turn) else np.eye(3)  # p_right = R^T p
    fold2 = fold_radius(lens.distortion) ** 2
    numbers = np.array([lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px, *lens.distortion, fold2])
    shape = (len(poses), *points.shape[:2], 2)
    left, right = np.empty(shape), np.empty(shape)
    _project_both_eyes(np.ascontiguousarray(poses), points, lens.baseline_m, R_left_right, numbers, left, right)
    return left, right


@njit(cache=True)
def _project_both_eyes(
    poses: Array, points: Array, baseline_m: float, R_left_right: Array, lens: Array, left: Array, right: Array
) -> None:
    """`project_stereo` of points (k, c, 3) under poses (m, 4, 4), the right eye turned, in one pass."""
    at, turned = np.zeros(3), np.zeros(3)
    for i in range(poses.shape[0]):
        for k in range(points.shape[0]):
            for c in range(points.shape[1]):
                for row in range(3):
                    at[row] = poses[i, row, 3]
                    for column in range(3):
                        at[row] += poses[i, row, column] * points[k, c, column]
                _project_point(at, lens, left[i, k, c])
                at[0] -= baseline_m
                for row in range(3):
                    turned[row] = 0.0
                    for column in range(3):
                        turned[row] += R_left_right[column, row] * at[column]
                _project_point(turned, lens, right[i, k, c])


@njit(cache=True)
def _project_point(at: Array, lens: Array, out: Array) -> None:
    """`machine.camera.project` of one point (3,); lens: fx, fy, cx, cy, k1, k2, p1, p2, k3, square of its fold radius.

    NaN behind the eye, and where the lens model folds back into the picture.
    """
    if at[2] <= DEPTH_MIN_M:
        out[0] = out[1] = np.nan
        return
    x, y = at[0] / at[2], at[1] / at[2]
    k1, k2, p1, p2, k3 = lens[4], lens[5], lens[6], lens[7], lens[8]
    r2 = x * x + y * y
    if r2 >= lens[9]:
        out[0] = out[1] = np.nan
        return
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    out[0] = (x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)) * lens[0] + lens[2]
    out[1] = (y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y) * lens[1] + lens[3]


def points_on_links(Ts_base_link: Array, joints: Array, points: Array) -> Array:
    """Points (k, 3) [m] fixed to links `joints` (k,) (0: base), in the base frame (m, k, 3)."""
    chosen = Ts_base_link[:, np.asarray(joints, dtype=int)]
    return np.einsum("mkij,kj->mki", chosen[..., :3, :3], points) + chosen[..., :3, 3]
