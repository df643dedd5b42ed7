"""Nuisance parameters of the looks: each has a name, a prior sigma and a Jacobian on every answer. First-order.

A focal length, principal point, distortion and disparity that are off do not scatter: they move every look and bend all
odometry together, and a print that is too large seems too near every time. So they are unknowns of the joint estimate,
with what is believed of them before as priors. What no measurement has reduced widens every answer that depends on it:
tool and OOI are seen by the same camera, so what moves both alike cancels in the Jacobian itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machine.camera import project, projection_jacobian, undistort_to_rays
from machine.description import Machine, Marker, StereoCamera
from machine.markers import marker_corners
from machine.poses import moved_pose, transform_points
from machine.rotations import skew_matrices
from server.calibration.contracts import Array

LENS_PARAMETER_NAMES = (
    "focal length",
    "principal point x",
    "principal point y",
    "k1",
    "disparity",
    "tool marker print",
    "OOI marker print",
)
N_LENS, FOCAL, TOOL_PRINT, OOI_PRINT = len(LENS_PARAMETER_NAMES), 0, 5, 6
#: Steps for numerical derivatives: share, px, px, 1, px, share, share.
LENS_DERIVATIVE_STEPS = np.array([1e-4, 1e-2, 1e-2, 1e-4, 1e-2, 1e-4, 1e-4])
FOCAL_SIGMA_GOOD_FRAC = 0.0015  # one sigma that a careful calibration of the camera leaves
FOCAL_DOUBT_SIGMAS = 3.0  # a right camera is doubted once in 370 paths
PLANE_POINTS_MIN = 6
FALLBACK_MARKER_SIDE_M = 0.15  # for an object without single markers
FALLBACK_MARKER = Marker(
    -1, FALLBACK_MARKER_SIDE_M, "ooi", np.eye(4)
)  # a board hangs and is printed as well as a marker
WALL_GRID, BORDER_PX, WAY_M = (8, 6), 20.0, 0.1


@dataclass(frozen=True, slots=True)
class LensPrior:
    """What is believed before a measurement, one sigma (docs/decisions/0008-constant-errors-are-unknowns.md)."""

    sigma_focal_frac: float = 0.01  # from a data sheet, a factory or an old calibration
    sigma_principal_px: float = 1.0
    sigma_k1: float = 0.002
    sigma_disparity_px: float = 0.1
    sigma_print_frac: float = 0.002  # of all markers of one object: a ruler reads 0.3 mm of 150 mm
    sigma_side_frac: float = 7e-4  # of one marker against the others of its print
    sigma_layout_m: float = 3e-4  # of each of the OOI's markers, per axis
    sigma_layout_rad: float = float(np.deg2rad(0.1))

    @property
    def sigma(self) -> Array:
        """Of the lens unknowns (7,), in the order of `LENS_PARAMETER_NAMES`."""
        principal, prints = [self.sigma_principal_px] * 2, [self.sigma_print_frac] * 2
        return np.array([self.sigma_focal_frac, *principal, self.sigma_k1, self.sigma_disparity_px, *prints])


def eyes_off(camera: StereoCamera, lens: Array) -> tuple[StereoCamera, StereoCamera]:
    """The true left and right eye, if the file's camera were off by `lens` (7,)."""
    focal, cx, cy, k1, disparity = lens[:TOOL_PRINT]
    left = replace(
        camera,
        fx_px=camera.fx_px * (1.0 + focal),
        fy_px=camera.fy_px * (1.0 + focal),
        cx_px=camera.cx_px + cx,
        cy_px=camera.cy_px + cy,
        distortion=(camera.distortion[0] + k1, *camera.distortion[1:]),
    )
    return left, replace(left, cx_px=left.cx_px + disparity)


def look_sensitivity(machine: Machine, T_cam_tool: Array, T_cam_ooi: Array) -> Array:
    """Change of what a look measures per lens unknown (12, 7): tool, then OOI; rotation vector, then position.

    Model:   the corners' pixels by the true eyes are explained by a pose before the file's eyes, least squares over
             both: d pose = (d px / d pose)^+ d px / d lens.
    """
    seen = ((machine.markers_on("tool"), T_cam_tool, TOOL_PRINT), (machine.markers_on("ooi"), T_cam_ooi, OOI_PRINT))
    parts = []
    for own, T_cam_object, printed in seen:
        markers = own or (FALLBACK_MARKER,)
        changes = pixel_changes(machine.camera, T_cam_object, markers, printed)
        parts.append(_pose_jacobian_pinv(machine.camera, T_cam_object, corners_of(markers)) @ changes)
    return np.vstack(parts)


def common_covariance(machine: Machine, T_cam_tool: Array, T_cam_ooi: Array, prior: LensPrior, lens: Array) -> Array:
    """Covariance (12, 12) of a look from all that its pairs have in common; order of `look_sensitivity`.

    Model:   S L S^T; where the OOI's markers hang is added to its own block.
    Args:    lens: covariance L (7, 7) of the lens unknowns, of the prior or of an estimate.
    """
    S = look_sensitivity(machine, T_cam_tool, T_cam_ooi)
    C = S @ lens @ S.T
    C[6:, 6:] += layout_in_camera(machine, T_cam_ooi, prior)
    return 0.5 * (C + C.T)


def layout_in_camera(machine: Machine, T_cam_ooi: Array, prior: LensPrior) -> Array:
    """`layout_covariance` in camera axes (6, 6)."""
    turned = np.kron(np.eye(2), T_cam_ooi[:3, :3])
    return turned @ layout_covariance(machine, T_cam_ooi, prior) @ turned.T


def layout_covariance(machine: Machine, T_cam_ooi: Array, prior: LensPrior) -> Array:
    """Covariance (6, 6) of the OOI's pose by its markers, from where they hang and how they are printed.

    OOI axes: rotation vector [rad], then position [m]. No look at the same markers takes any of it away.
    """
    markers = machine.markers_on("ooi") or (FALLBACK_MARKER,)
    inverse = _pose_jacobian_pinv(machine.camera, T_cam_ooi, corners_of(markers))
    R = np.kron(np.eye(2), T_cam_ooi[:3, :3].T)
    found = R @ inverse @ layout_effects(machine.camera, T_cam_ooi, markers, prior)
    return found @ found.T


def layout_effects(camera: StereoCamera, T_cam_object: Array, markers: Sequence[Marker], prior: LensPrior) -> Array:
    """What one sigma of each marker's place (six) and side does to all corners' pixels (4 n, 7 markers)."""
    everything = corners_of(markers)
    base = both_pixels((camera, camera), transform_points(T_cam_object, everything))
    sigmas = [*[prior.sigma_layout_rad] * 3, *[prior.sigma_layout_m] * 3, prior.sigma_side_frac]
    effects = []
    for i, marker in enumerate(markers):
        for k, sigma in enumerate(sigmas):
            moved = everything.copy()
            moved[4 * i : 4 * i + 4] = _marker_off(marker, k, sigma)
            effects.append(both_pixels((camera, camera), transform_points(T_cam_object, moved)) - base)
    return np.nan_to_num(np.array(effects)).T


def odometry_sensitivity(camera: StereoCamera, T_cam_ooi: Array) -> Array:
    """Share of a step that odometry adds to it, per lens unknown (7, 3, 3), camera axes.

    Model:   points of the OOI's plane are triangulated once; a step of `WAY_M` later both eyes' pixels are explained by
             the camera's pose, least squares. All to first order.
    """
    points = _plane_points(camera, T_cam_ooi)
    still = _lens_changes(camera, points)
    off = np.linalg.pinv(_point_jacobian(camera, points)) @ still  # of the triangulated points (n, 3, 6)
    found = np.zeros((N_LENS, 3, 3))
    for axis, step in enumerate(WAY_M * np.eye(3)):
        seen = points - step
        pixels = both_pixels((camera, camera), seen).reshape(-1, 4)
        rows = _in_image(camera, pixels[:, :2]) & _in_image(camera, pixels[:, 2:])
        J = _point_jacobian(camera, seen[rows])
        unexplained = (J @ off[rows] - _lens_changes(camera, seen[rows])).reshape(-1, N_LENS)
        J_camera = np.concatenate([J @ skew_matrices(seen[rows]), J], axis=2).reshape(-1, 6)
        solved = np.linalg.lstsq(J_camera, unexplained, rcond=None)[0]
        found[:, :, axis] = solved[3:].T / WAY_M
    return found


def shows_plane(camera: StereoCamera, T_cam_ooi: Array) -> bool:
    """Whether both eyes see enough of the OOI's plane to say what a lens does to odometry there."""
    return len(_plane_points(camera, T_cam_ooi)) >= PLANE_POINTS_MIN


def corners_of(markers: Sequence[Marker], grown: float = 0.0) -> Array:
    """Corners (n, 3) [m] on their object, each marker grown by a share about its middle."""
    side = 1.0 + grown
    return np.vstack([transform_points(marker.T_on_marker, marker_corners(marker.side_m * side)) for marker in markers])


def _marker_off(marker: Marker, number: int, by: float) -> Array:
    """Corners (4, 3) of a marker turned (0 to 2), shifted (3 to 5) or grown (6)."""
    corners = marker_corners(marker.side_m * (1.0 + by if number == 6 else 1.0))
    return transform_points(moved_pose(marker.T_on_marker, by * np.eye(7)[number, :6]), corners)


def both_pixels(eyes: tuple[StereoCamera, StereoCamera], points_cam: Array) -> Array:
    """Left and right pixels side by side, flat (4 n,)."""
    shift = np.array([eyes[0].baseline_m, 0.0, 0.0])
    return np.concatenate([project(eyes[0], points_cam), project(eyes[1], points_cam - shift)], axis=1).ravel()


def _pose_jacobian_pinv(camera: StereoCamera, T_cam_object: Array, corners: Array) -> Array:
    """(d px / d pose)^+ (6, 4 n)."""
    return np.asarray(np.linalg.pinv(pose_jacobian(camera, T_cam_object, corners)), dtype=np.float64)


def pose_jacobian(camera: StereoCamera, T_cam_object: Array, corners: Array) -> Array:
    """d px / d pose (4 n, 6): rotation vector about the object's origin, then position, camera axes."""
    J_points = _point_jacobian(camera, transform_points(T_cam_object, corners))
    turns = -skew_matrices(corners @ T_cam_object[:3, :3].T)
    return np.nan_to_num(np.concatenate([J_points @ turns, J_points], axis=2).reshape(-1, 6))


def pixel_changes(camera: StereoCamera, T_cam_object: Array, markers: Sequence[Marker], printed: int) -> Array:
    """d px / d lens (4 n, 7); `printed`: which unknown is the scale of this object's print."""
    points = transform_points(T_cam_object, corners_of(markers))
    changes = _lens_changes(camera, points).reshape(-1, N_LENS)
    h = LENS_DERIVATIVE_STEPS[printed]
    grown = transform_points(T_cam_object, corners_of(markers, h))
    changes[:, printed] = (both_pixels((camera, camera), grown) - both_pixels((camera, camera), points)) / h
    return np.nan_to_num(changes)


def _lens_changes(camera: StereoCamera, points_cam: Array) -> Array:
    """d px / d lens (n, 4, 7); zero for the prints."""
    base = both_pixels((camera, camera), points_cam)
    steps = np.diag(LENS_DERIVATIVE_STEPS)
    columns = [
        (both_pixels(eyes_off(camera, step), points_cam) - base) / h
        for step, h in zip(steps, LENS_DERIVATIVE_STEPS, strict=True)
    ]
    return np.nan_to_num(np.stack(columns, axis=-1)).reshape(-1, 4, N_LENS)


def _point_jacobian(camera: StereoCamera, points_cam: Array) -> Array:
    """d px / d point (n, 4, 3), both eyes."""
    shift = np.array([camera.baseline_m, 0.0, 0.0])
    both = [projection_jacobian(camera, points_cam), projection_jacobian(camera, points_cam - shift)]
    return np.nan_to_num(np.concatenate(both, axis=1))


def _plane_points(camera: StereoCamera, T_cam_ooi: Array) -> Array:
    """Points (n, 3) [m] of the OOI's plane over the left image, those that the right eye sees too."""
    columns = np.linspace(BORDER_PX, camera.width_px - BORDER_PX, WALL_GRID[0])
    rows = np.linspace(BORDER_PX, camera.height_px - BORDER_PX, WALL_GRID[1])
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    rays = np.column_stack([undistort_to_rays(camera, pixels), np.ones(len(pixels))])
    normal = T_cam_ooi[:3, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        points = rays * (T_cam_ooi[:3, 3] @ normal / (rays @ normal))[:, None]
    points = points[np.isfinite(points).all(axis=1) & (points[:, 2] > 2.0 * WAY_M)]
    if not len(points):
        return points
    right = both_pixels((camera, camera), points).reshape(-1, 4)[:, 2:]
    return points[_in_image(camera, right)]


def _in_image(camera: StereoCamera, pixels: Array) -> NDArray[np.bool_]:
    last = np.array([camera.width_px, camera.height_px])
    return np.all(np.isfinite(pixels) & (pixels > 0.0) & (pixels < last), axis=1)
