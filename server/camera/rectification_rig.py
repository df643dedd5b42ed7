"""A stereo rig as calibrated: both eyes with their lenses, and how the right eye sits to the left one. Pure."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from machine.rotations import Array, geodesic_angle, nearest_rotation
from server.camera.errors import CameraError

LensModel = Literal["brown", "fisheye"]
BROWN_COEFFICIENT_COUNTS = (0, 4, 5, 8, 12, 14)  # coefficients that OpenCV's pinhole model knows
FISHEYE_COEFFICIENT_COUNT = 4
IMAGE_SIDE_MAX_PX = 8192
FOCAL_MIN_FRAC, FOCAL_MAX_FRAC = 0.1, 20.0  # of the image's width
ORTHONORMALITY_ERROR_MAX = 1e-3
EYE_ROTATION_MAX_DEG = 30.0  # between the eyes; a stereo pair with more does not rectify well
BASELINE_MIN_M, BASELINE_MAX_M = 0.01, 2.5
DISTORTION_COEFFICIENT_MAX = 1e4
RADIUS_MAX, RADIUS_STEPS = 6.0, 3001  # undistorted focal lengths at which a lens is asked whether it folds back


class CalibrationFileError(CameraError):
    """A calibration file that cannot be used: names file, field, value, limit and remedy."""

    code = "camera_calibration"


@dataclass(frozen=True, slots=True, eq=False)
class EyeCalibration:
    """One eye: focal lengths and principal point [px], lens.

    `distortion`: OpenCV's order; brown k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tx ty]]]], fisheye k1 k2 k3 k4.
    """

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, ...] = ()
    lens_model: LensModel = "brown"

    @property
    def matrix(self) -> Array:
        """Camera matrix (3, 3) [px]."""
        return np.array([[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]])

    @property
    def coefficients(self) -> Array:
        """Distortion for OpenCV, at least four numbers."""
        return np.array(self.distortion if self.distortion else (0.0,) * 4)


@dataclass(frozen=True, slots=True, eq=False)
class RigCalibration:
    """Both eyes at one image size. A point p [m] of the left eye is R_right_left @ p + t_right_left_m in the right."""

    left: EyeCalibration
    right: EyeCalibration
    R_right_left: Array
    t_right_left_m: Array
    width_px: int
    height_px: int

    @property
    def baseline_m(self) -> float:
        """Distance between the eyes."""
        return float(np.linalg.norm(self.t_right_left_m))


def eye_from_matrix(matrix: Array, distortion: Array, model: LensModel, file: str, field: str) -> EyeCalibration:
    """One eye from its camera matrix (3, 3) and coefficients.

    Raises: CalibrationFileError: not a camera matrix, or one with skew.
    """
    if matrix.shape != (3, 3) or abs(matrix[2, 2] - 1.0) > 1e-6:
        raise CalibrationFileError(f"{file}: {field} is not a camera matrix with last row 0 0 1; give 3 x 3 numbers")
    if abs(matrix[0, 1]) > 1e-6 * abs(matrix[0, 0]) or np.abs(matrix[[1, 2, 2], [0, 0, 1]]).max() > 1e-9:
        raise CalibrationFileError(f"{file}: {field} has skew {matrix[0, 1]:g} px; calibrate without skew")
    return EyeCalibration(
        float(matrix[0, 0]),
        float(matrix[1, 1]),
        float(matrix[0, 2]),
        float(matrix[1, 2]),
        tuple(float(value) for value in distortion.ravel()),
        model,
    )


def translation_in_metres(t: Array, file: str, field: str) -> Array:
    """A translation between the eyes in metres, from metres or millimetres: which of the two follows from its length.

    Raises: CalibrationFileError: it is neither (chessboard squares or centimetres, most likely).
    """
    length = float(np.linalg.norm(t))
    if BASELINE_MIN_M <= length <= BASELINE_MAX_M:
        return t
    if 20.0 <= length <= 1e3 * BASELINE_MAX_M:
        return t * 1e-3
    raise CalibrationFileError(
        f"{file}: {field} has length {length:g}; neither metres ({BASELINE_MIN_M:g} .. {BASELINE_MAX_M:g}) nor "
        f"millimetres (20 .. {1e3 * BASELINE_MAX_M:g}); write the distance of the eyes in metres"
    )


def checked_rig(rig: RigCalibration, file: str) -> RigCalibration:
    """The rig with its rotation made exact.

    Raises: CalibrationFileError: a number that no stereo rig has.
    """
    size = (rig.width_px, rig.height_px)
    if not all(0 < side <= IMAGE_SIDE_MAX_PX for side in size):
        raise CalibrationFileError(f"{file}: image size {size[0]} x {size[1]} px (limit 1 .. {IMAGE_SIDE_MAX_PX})")
    for name, eye in (("left", rig.left), ("right", rig.right)):
        check_eye(eye, size, f"{file}: {name} eye")
    R, t = rig.R_right_left, rig.t_right_left_m
    if R.shape != (3, 3) or t.shape != (3,) or not np.isfinite(R).all() or not np.isfinite(t).all():
        raise CalibrationFileError(
            f"{file}: rotation or translation between the eyes is not 3 x 3 and 3 finite numbers"
        )
    defect = float(np.abs(R @ R.T - np.eye(3)).max())
    if defect > ORTHONORMALITY_ERROR_MAX or np.linalg.det(R) < 0.0:
        raise CalibrationFileError(
            f"{file}: rotation between the eyes is off orthonormal by {defect:.1e} (limit {ORTHONORMALITY_ERROR_MAX:g})"
            " or mirrored; give the R of the stereo calibration"
        )
    _check_places(R, t, file)
    exact, shift = nearest_rotation(R), np.array(t, dtype=float)
    exact.setflags(write=False)
    shift.setflags(write=False)
    return RigCalibration(rig.left, rig.right, exact, shift, *size)


def _check_places(R: Array, t: Array, file: str) -> None:
    turn_deg = float(np.rad2deg(geodesic_angle(np.eye(3), nearest_rotation(R))))
    if turn_deg > EYE_ROTATION_MAX_DEG:
        raise CalibrationFileError(
            f"{file}: the eyes are turned by {turn_deg:.1f} deg against each other (limit {EYE_ROTATION_MAX_DEG:g}); "
            "is it the rotation from the left to the right eye?"
        )
    length = float(np.linalg.norm(t))
    if not BASELINE_MIN_M <= length <= BASELINE_MAX_M:
        limits = f"{BASELINE_MIN_M:g} .. {BASELINE_MAX_M:g} m"
        raise CalibrationFileError(f"{file}: the eyes are {length:g} m apart (limits {limits}); check the unit")
    across = -0.5 * (R.T @ t + t) / length  # the right eye's place, seen from between the eyes' axes
    if abs(across[0]) < 0.7:
        raise CalibrationFileError(
            f"{file}: the right eye lies above, below or behind the left one, at {across}; turn the rig"
        )
    if across[0] < 0.0:
        raise CalibrationFileError(
            f"{file}: the right eye lies to the left of the left eye ({across[0] * length:.4f} m); exchange the eyes"
        )


def check_eye(eye: EyeCalibration, size: tuple[int, int], subject: str) -> None:
    """Raises: CalibrationFileError: not a lens for pictures of this size (width, height) [px]."""
    counts = (FISHEYE_COEFFICIENT_COUNT,) if eye.lens_model == "fisheye" else BROWN_COEFFICIENT_COUNTS
    if len(eye.distortion) not in counts:
        raise CalibrationFileError(
            f"{subject}: {len(eye.distortion)} distortion coefficients ({eye.lens_model} has {counts})"
        )
    values = np.array([eye.fx_px, eye.fy_px, eye.cx_px, eye.cy_px, *eye.distortion])
    if not np.isfinite(values).all() or np.abs(values[4:]).max(initial=0.0) > DISTORTION_COEFFICIENT_MAX:
        raise CalibrationFileError(f"{subject}: {values.tolist()} holds a number that is not finite or too large")
    for name, focal in (("fx", eye.fx_px), ("fy", eye.fy_px)):
        low, high = FOCAL_MIN_FRAC * size[0], FOCAL_MAX_FRAC * size[0]
        if not low <= focal <= high:
            raise CalibrationFileError(
                f"{subject}: {name} = {focal:g} px for images {size[0]} px wide (limits {low:g} .. {high:g}); is the "
                "calibration of another resolution?"
            )
    for name, centre, side in (("cx", eye.cx_px, size[0]), ("cy", eye.cy_px, size[1])):
        if not 0.0 <= centre <= side - 1.0:
            raise CalibrationFileError(
                f"{subject}: {name} = {centre:g} px lies outside the image (0 .. {side - 1}); is the calibration of "
                "another resolution?"
            )
    _check_fold(eye, size, subject)


def _check_fold(eye: EyeCalibration, size: tuple[int, int], subject: str) -> None:
    """Refuse a lens that folds back, or ends, within the image."""
    if not any(eye.distortion):
        return
    x = max(eye.cx_px, size[0] - 1.0 - eye.cx_px) / eye.fx_px
    y = max(eye.cy_px, size[1] - 1.0 - eye.cy_px) / eye.fy_px
    corner, reach = float(np.hypot(x, y)), distorted_reach(eye)
    if corner >= reach:
        raise CalibrationFileError(
            f"{subject}: the lens model folds back at {reach:.3f} focal lengths from the axis, the image's corner "
            f"is at {corner:.3f}; calibrate with marks out to the corners, or with fewer coefficients"
        )


def distorted_reach(eye: EyeCalibration) -> float:
    """Largest distorted radius [focal lengths] up to which the radial model grows; tangential terms left out."""
    if eye.lens_model == "fisheye":
        r = np.linspace(0.0, np.pi, RADIUS_STEPS)  # a fisheye may look behind itself
        powers = np.stack([r ** (2 * k) for k in range(5)])
        distorted = r * (np.array([1.0, *eye.distortion]) @ powers)
    else:
        r = np.linspace(0.0, RADIUS_MAX, RADIUS_STEPS)
        k = np.zeros(14)
        k[: len(eye.distortion)] = eye.distortion
        r2 = r * r
        below = 1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
        above = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
        good = np.logical_and.accumulate(below > 1e-6)
        distorted = np.where(good, r * above / np.where(good, below, 1.0), -1.0)
    falling = np.flatnonzero(np.diff(distorted) <= 0.0)
    return float(distorted[falling[0]]) if len(falling) else float(distorted[-1])
