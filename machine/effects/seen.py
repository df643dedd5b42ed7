"""What camera, odometry and tracker measure of a machine with effects: corners, paths and points, over many samples."""

from dataclasses import dataclass, replace

import numpy as np

from machine.camera import distort_rays
from machine.description import StereoCamera
from machine.effects.layout import (
    CLOCK_OFFSET,
    CLOCK_RATE_PPM,
    FOCAL,
    HAND_EYE_ROTATION,
    HAND_EYE_TRANSLATION,
    K1,
    LATENCY,
    MARKER_SIZE,
    ODOMETRY_SCALE,
    PRINCIPAL,
    READOUT,
    STEREO,
    ParameterSets,
)
from machine.errors import MachineError
from machine.markers import marker_corners
from machine.rotations import Array, rotation_from_rotvec
from machine.targets import Marker

DEPTH_MIN_M = 1e-6  # at or behind the eye: NaN


def true_times(sets: ParameterSets, t_camera_s: Array, t_zero_s: float, which: int = 0) -> Array:
    """When images with these stamps were really exposed, on the PLC's clock (m,) [s].

    Model: t_camera = t_true + offset + rate (t_true - t_zero) + latency; identity at neutral.
    Args:  t_camera_s: stamps mapped by the best known offset (m,) [s]. t_zero_s: start of the recording [s].
    """
    G = sets.machine[which]
    rate = 1e-6 * G[CLOCK_RATE_PPM]
    stamps = np.asarray(t_camera_s, dtype=float)
    return (stamps - G[CLOCK_OFFSET] - G[LATENCY] + rate * t_zero_s) / (1.0 + rate)


def sampled(t_s: Array, values: Array, t_wanted_s: Array) -> Array:
    """Rows of an evenly or unevenly sampled signal (k, n) at other times (m,), linear; ends are held."""
    values = np.asarray(values, dtype=float)
    return np.stack([np.interp(t_wanted_s, t_s, values[:, j]) for j in range(values.shape[1])], axis=1)


def camera_mount(sets: ParameterSets, T_tcp_cam_left: Array, which: int = 0) -> Array:
    """True T_tcp_cam_left (4, 4): turned about its own axes, moved along the tcp's."""
    G = sets.machine[which]
    T = np.array(T_tcp_cam_left, dtype=float)
    if np.any(G[HAND_EYE_ROTATION]):
        T[:3, :3] = T[:3, :3] @ rotation_from_rotvec(G[HAND_EYE_ROTATION])
    T[:3, 3] += G[HAND_EYE_TRANSLATION]
    return T


def true_camera(sets: ParameterSets, camera: StereoCamera, which: int = 0) -> StereoCamera:
    """The camera as it is: focal lengths, principal point, first radial coefficient."""
    G = sets.machine[which]
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
    """Corners of each marker in each sample: left and right (m, markers, 4, 2) [px]; NaN behind an eye."""

    left: Array
    right: Array


def marker_points(sets: ParameterSets, markers: tuple[Marker, ...], which: int = 0) -> Array:
    """True corners on the object (markers, 4, 3) [m]."""
    size = 1.0 + sets.machine[which, MARKER_SIZE]
    points = [marker_corners(one.side_m * size) @ one.T_on_marker[:3, :3].T + one.T_on_marker[:3, 3] for one in markers]
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
             times (row / last row - 1/2) readout, the speed from a second set of poses dt_s later.
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
    readout = float(sets.machine[which, READOUT])
    if readout == 0.0 or Ts_cam_object_later is None:
        return Corners(left, right)
    if not dt_s > 0.0:
        raise MachineError(f"later poses are {dt_s} s later; give a time above 0 s")
    later = _both_eyes(sets, lens, np.asarray(Ts_cam_object_later, dtype=float), points, which)
    return Corners(
        *(_sheared(one, two, camera.height_px, readout / dt_s) for one, two in zip((left, right), later, strict=True))
    )


def _sheared(pixels: Array, later: Array, height_px: int, readout_over_dt: float) -> Array:
    row = pixels[..., 1:] / (height_px - 1.0) - 0.5
    return pixels + (later - pixels) * row * readout_over_dt


def _both_eyes(sets: ParameterSets, lens: StereoCamera, poses: Array, points: Array, which: int) -> tuple[Array, Array]:
    at_left = np.einsum("mij,kcj->mkci", poses[:, :3, :3], points) + poses[:, None, None, :3, 3]
    at_right = at_left - np.array([lens.baseline_m, 0.0, 0.0])
    turn = sets.machine[which, STEREO]
    if np.any(turn):
        at_right = at_right @ rotation_from_rotvec(turn)  # R_left_right: p_right = R^T p
    return _pixels(lens, at_left), _pixels(lens, at_right)


def _pixels(lens: StereoCamera, points: Array) -> Array:
    depth = np.where(points[..., 2:] > DEPTH_MIN_M, points[..., 2:], np.nan)
    rays = (points[..., :2] / depth).reshape(-1, 2)
    focal, centre = np.array([lens.fx_px, lens.fy_px]), np.array([lens.cx_px, lens.cy_px])
    return (distort_rays(lens, rays) * focal + centre).reshape(*points.shape[:-1], 2)


def seen_odometry(sets: ParameterSets, Ts_base_cam: Array, which: int = 0) -> Array:
    """Odometry's poses of the left camera in its own first frame (m, 4, 4), translations scaled."""
    poses = np.asarray(Ts_base_cam, dtype=float)
    first = poses[0]
    out = np.tile(np.eye(4), (len(poses), 1, 1))
    out[:, :3, :3] = first[:3, :3].T @ poses[:, :3, :3]
    out[:, :3, 3] = (poses[:, :3, 3] - first[:3, 3]) @ first[:3, :3] * (1.0 + sets.machine[which, ODOMETRY_SCALE])
    return out


def points_on_links(Ts_base_link: Array, joints: Array, points: Array) -> Array:
    """Points (k, 3) [m] fixed to links `joints` (k,) (0: base), in the base frame (m, k, 3)."""
    chosen = Ts_base_link[:, np.asarray(joints, dtype=int)]
    return np.einsum("mkij,kj->mki", chosen[..., :3, :3], points) + chosen[..., :3, 3]
