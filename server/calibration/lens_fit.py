"""Lens of one eye or of a stereo rig from a board's corners, with covariance, and what to photograph next."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from server.calibration.contracts import Array

LENS_PARAMETER_NAMES = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3")
RIG_PARAMETER_NAMES = ("rx_rad", "ry_rad", "rz_rad", "tx_m", "ty_m", "tz_m")
CORNERS_MIN = 8  # of one view in one eye
VIEWS_MIN = 6
ITERATIONS_MAX = 60
OUTLIER_RMS_FACTOR = 4.0  # times the median view's: the board was bent, blurred or taken for another


class LensFitError(ValueError):
    """Views that give no lens; says why and what to photograph."""


@dataclass(frozen=True, slots=True)
class BoardView:
    """One picture of the board: for each eye, points (n, 3) [m, board] and corners (n, 2) [px]; None if not seen."""

    name: str
    eye_correspondences: tuple[tuple[Array, Array] | None, ...]


@dataclass(frozen=True, slots=True)
class LensFit:
    """`lens_parameters`: each eye's in the order of `LENS_PARAMETER_NAMES` (eyes, 9); `rig_parameters`: rotation vector
    [rad] and translation [m] that take the left eye's points to the right one's (6,), None for one eye. `covariance`:
    of both, in this order. `rms_px`: per coordinate; `view_rms_px`: of each used view; `dropped_views`: with the
    reason.
    `board_poses`: rotation vector and translation of the board in the left eye, of each used view (views, 6).
    """

    size_px: tuple[int, int]
    lens_parameters: Array
    rig_parameters: Array | None
    covariance: Array
    rms_px: float
    view_rms_px: Array
    used_views: tuple[str, ...]
    dropped_views: tuple[tuple[str, str], ...]
    board_poses: Array

    @property
    def covariance_names(self) -> tuple[str, ...]:
        """What each row of the covariance is."""
        eyes = ("left", "right") if len(self.lens_parameters) == 2 else ("lens",)
        return tuple(f"{eye}.{name}" for eye in eyes for name in LENS_PARAMETER_NAMES) + (
            () if self.rig_parameters is None else RIG_PARAMETER_NAMES
        )

    @property
    def values(self) -> Array:
        """The numbers that `covariance_names` names."""
        return np.concatenate(
            [self.lens_parameters.ravel(), *([] if self.rig_parameters is None else [self.rig_parameters])]
        )


def fit_lens(views: Sequence[BoardView], size_px: tuple[int, int]) -> LensFit:
    """The lens or the rig that all views agree on best.

    Model:   minimum of the sum over views, eyes, corners of |pi(T_eye_board X) - u|^2 over five-coefficient lenses, the
             rig and every board's pose, by Levenberg-Marquardt. Covariance s^2 (J^T J)^-1 with s^2 from the residuals.
             Views whose rms is beyond four times the median's are left out, and it is fitted again.
    Raises:  LensFitError: too few views, or all of them alike.
    Source:  Zhang 2000; OpenCV projectPoints and composeRT for the derivatives.
    """
    usable = [view for view in views if _has_visible_board(view) and _is_whole(view)]
    dropped = [(view.name, f"fewer than {CORNERS_MIN} corners in an eye") for view in views if view not in usable]
    fitted = _fit_lens(usable, size_px)
    outlying = fitted.view_rms_px > OUTLIER_RMS_FACTOR * np.median(fitted.view_rms_px)
    if outlying.any():
        limit = f"its rms is beyond {OUTLIER_RMS_FACTOR:g} times the median's"
        dropped += [
            (view.name, f"{rms:.2f} px: {limit}")
            for view, rms, off in zip(usable, fitted.view_rms_px, outlying, strict=True)
            if off
        ]
        fitted = _fit_lens([view for view, off in zip(usable, outlying, strict=True) if not off], size_px)
    return replace(fitted, dropped_views=tuple(dropped))


def _has_visible_board(view: BoardView) -> bool:
    return any(eye is not None for eye in view.eye_correspondences)


def _is_whole(view: BoardView) -> bool:
    return all(eye is not None and len(eye[0]) >= CORNERS_MIN for eye in view.eye_correspondences)


def _fit_lens(views: Sequence[BoardView], size_px: tuple[int, int]) -> LensFit:
    if len(views) < VIEWS_MIN:
        raise LensFitError(f"{len(views)} views show the board well, at least {VIEWS_MIN} are needed; photograph more")
    problem = _Problem(views)
    x = problem.start(size_px)
    residuals, J = problem.evaluate(x)
    damping = 1e-3
    for _ in range(ITERATIONS_MAX):
        H, g = J.T @ J, J.T @ residuals
        step = -np.linalg.solve(H + damping * np.diag(np.diag(H)), g)
        tried, tried_J = problem.evaluate(x + step)
        if tried @ tried <= residuals @ residuals:
            gain = float(residuals @ residuals - tried @ tried)
            x, residuals, J, damping = x + step, tried, tried_J, max(0.1 * damping, 1e-12)
            if gain < 1e-12 * float(tried @ tried) + 1e-18:
                break
        elif (damping := 10.0 * damping) > 1e10:
            break
    H = J.T @ J
    scale = np.sqrt(np.diag(H))
    scaled = H / np.outer(scale, scale)
    if not np.isfinite(scaled).all() or np.linalg.eigvalsh(scaled)[0] < 1e-13:
        raise LensFitError("the views cannot distinguish focal length from distance; tilt the board by 30 deg and more")
    variance = float(residuals @ residuals) / max(len(residuals) - len(x), 1)
    covariance = variance * np.linalg.inv(scaled) / np.outer(scale, scale)
    return problem.result(x, covariance, residuals, size_px)


class _Problem:
    """Unknowns: each eye's lens, the rig, then six numbers a view."""

    def __init__(self, views: Sequence[BoardView]) -> None:
        self._views = views
        self._eyes = len(views[0].eye_correspondences)
        self._fixed = 9 * self._eyes + (6 if self._eyes == 2 else 0)
        self._data = [
            [
                (np.ascontiguousarray(points), np.ascontiguousarray(px))
                for points, px in (e for e in view.eye_correspondences if e)
            ]
            for view in views
        ]

    def start(self, size_px: tuple[int, int]) -> Array:
        """Each eye by itself, then the rig as the median of what the views say."""
        lenses, poses = [], []
        for eye in range(self._eyes):
            points = [data[eye][0].astype(np.float32) for data in self._data]
            corners = [data[eye][1].astype(np.float32) for data in self._data]
            try:
                _, K, d, rvecs, tvecs = cv2.calibrateCamera(points, corners, size_px, None, None)  # type: ignore[call-overload]
            except cv2.error as error:
                raise LensFitError("no lens fits these views; check the board's squares and sizes") from error
            lenses.append([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *d.ravel()[:5]])
            poses.append(np.hstack([np.array(rvecs).reshape(-1, 3), np.array(tvecs).reshape(-1, 3)]))
        parts = [np.array(lenses).ravel()]
        if self._eyes == 2:
            relative = [
                cv2.composeRT(*_inverse_pose_vectors(left), *_rotvec_and_translation(right))[:2]
                for left, right in zip(*poses, strict=True)
            ]
            parts.append(np.median([np.concatenate([r.ravel(), t.ravel()]) for r, t in relative], axis=0))
        return np.concatenate([*parts, poses[0].ravel()])

    def evaluate(self, x: Array) -> tuple[Array, Array]:
        """Residuals (m,) [px] and Jacobian (m, p)."""
        rig = x[9 * self._eyes : self._fixed]
        blocks, rows = [], []
        for number, data in enumerate(self._data):
            at = self._fixed + 6 * number
            board = x[at : at + 6]
            for eye, (points, px) in enumerate(data):
                lens = x[9 * eye : 9 * eye + 9]
                K = np.array([[lens[0], 0.0, lens[2]], [0.0, lens[1], lens[3]], [0.0, 0.0, 1.0]])
                r, t = _rotvec_and_translation(board)
                chain = None
                if eye == 1:
                    r, t, *chain = cv2.composeRT(r, t, *_rotvec_and_translation(rig))
                seen, J = cv2.projectPoints(points, r, t, K, lens[4:])
                row = np.zeros((2 * len(px), len(x)))
                row[:, 9 * eye : 9 * eye + 9] = J[:, 6:15]
                if chain is None:
                    row[:, at : at + 6] = J[:, :6]
                else:
                    dr_r1, dr_t1, dr_r2, dr_t2, dt_r1, dt_t1, dt_r2, dt_t2 = chain
                    turn, move = J[:, :3], J[:, 3:6]
                    row[:, at : at + 3] = turn @ dr_r1 + move @ dt_r1
                    row[:, at + 3 : at + 6] = turn @ dr_t1 + move @ dt_t1
                    row[:, self._fixed - 6 : self._fixed - 3] = turn @ dr_r2 + move @ dt_r2
                    row[:, self._fixed - 3 : self._fixed] = turn @ dr_t2 + move @ dt_t2
                blocks.append((seen.reshape(-1, 2) - px).ravel())
                rows.append(row)
        return np.concatenate(blocks), np.vstack(rows)

    def result(self, x: Array, covariance: Array, residuals: Array, size_px: tuple[int, int]) -> LensFit:
        """The fit in the caller's form."""
        counts = [sum(px.size for _, px in data) for data in self._data]
        ends = np.cumsum([0, *counts])
        rms = [float(np.sqrt(np.mean(residuals[first:end] ** 2))) for first, end in pairwise(ends)]
        return LensFit(
            size_px=size_px,
            lens_parameters=x[: 9 * self._eyes].reshape(self._eyes, 9),
            rig_parameters=x[9 * self._eyes : self._fixed] if self._eyes == 2 else None,
            covariance=covariance[: self._fixed, : self._fixed],
            rms_px=float(np.sqrt(np.mean(residuals**2))),
            view_rms_px=np.array(rms),
            used_views=tuple(view.name for view in self._views),
            dropped_views=(),
            board_poses=x[self._fixed :].reshape(-1, 6),
        )


def _rotvec_and_translation(pose: Array) -> tuple[Array, Array]:
    return np.ascontiguousarray(pose[:3]), np.ascontiguousarray(pose[3:6])


def _inverse_pose_vectors(pose: Array) -> tuple[Array, Array]:
    R, _ = cv2.Rodrigues(np.ascontiguousarray(pose[:3]))
    return np.ascontiguousarray(-pose[:3]), np.ascontiguousarray(-R.T @ pose[3:6])


COLUMNS, ROWS = 8, 6
BOARD_TILT_MIN_DEG = 20.0
TILTED_VIEWS_MIN = 3  # views tilted that far to each of four sides
DISTANCE_RATIO_MIN = 1.6  # farthest over nearest
FOCAL_SIGMA_MAX_FRAC = 1e-3
VIEWS_RECOMMENDED = 15
IMAGE_REGION_NAMES = ("left", "middle", "right"), ("top", "middle", "bottom")


@dataclass(frozen=True, slots=True)
class Coverage:
    """Corners in each part of each eye's picture (eyes, ROWS, COLUMNS), and what to photograph next."""

    corner_counts: NDArray[np.int64]
    advice: tuple[str, ...]


def coverage_of(views: list[BoardView], fit: LensFit) -> Coverage:
    """The coverage of the used views. Args: views: all of them; those that the fit dropped do not count."""
    used = [view for view in views if view.name in set(fit.used_views)]
    width, height = fit.size_px
    counts = np.zeros((len(fit.lens_parameters), ROWS, COLUMNS), dtype=np.int64)
    for view in used:
        for eye, seen in enumerate(view.eye_correspondences):
            if seen is not None:
                u = np.clip((seen[1][:, 0] / width * COLUMNS).astype(int), 0, COLUMNS - 1)
                v = np.clip((seen[1][:, 1] / height * ROWS).astype(int), 0, ROWS - 1)
                np.add.at(counts[eye], (v, u), 1)
    return Coverage(counts, tuple(_view_coverage_advice(counts, fit)))


def _view_coverage_advice(counts: NDArray[np.int64], fit: LensFit) -> list[str]:
    out = []
    empty = (counts == 0).any(axis=0)
    if empty.any():
        places = sorted({_image_region_name(row, column) for row, column in np.argwhere(empty)})
        out.append(f"hold the board into the {', '.join(places)} of the picture: no corner was seen there")
    tilts = np.array([_tilt_deg(board) for board in fit.board_poses])
    for axis, sides in ((0, ("its top", "its bottom")), (1, ("its left side", "its right side"))):
        for sign, side in zip((1.0, -1.0), sides, strict=True):
            count = int(np.sum(sign * tilts[:, axis] > BOARD_TILT_MIN_DEG))
            if count < TILTED_VIEWS_MIN:
                out.append(
                    f"tilt the board by 30 to 45 deg with {side} away from the camera: {count} of {TILTED_VIEWS_MIN} "
                    "views"
                )
    distances = np.linalg.norm(fit.board_poses[:, 3:], axis=1)
    if distances.max() < DISTANCE_RATIO_MIN * distances.min():
        near, far = 1e3 * distances.min(), 1e3 * distances.max()
        out.append(f"go nearer and farther: all views lie between {near:.0f} and {far:.0f} mm")
    sigma = float(np.sqrt(fit.covariance[0, 0]) / fit.lens_parameters[0, 0])
    if sigma > FOCAL_SIGMA_MAX_FRAC and not out:
        out.append(
            f"more views: the focal length is known to {100 * sigma:.2f} %, {100 * FOCAL_SIGMA_MAX_FRAC:.1f} % is good"
        )
    if len(fit.used_views) < VIEWS_RECOMMENDED:
        out.append(f"{len(fit.used_views)} views are used, {VIEWS_RECOMMENDED} are good")
    return out


def _image_region_name(row: int, column: int) -> str:
    across = IMAGE_REGION_NAMES[0][0 if column < 3 else 2 if column > 4 else 1]
    down = IMAGE_REGION_NAMES[1][0 if row < 2 else 2 if row > 3 else 1]
    return "middle" if across == down == "middle" else f"{down} {across}".replace("middle ", "").replace(" middle", "")


def _tilt_deg(board: Array) -> tuple[float, float]:
    """How far the board's normal leans [deg]: positive with its top, and with its left side, away from the camera."""
    R, _ = cv2.Rodrigues(np.ascontiguousarray(board[:3]))
    normal = R[:, 2] if R[2, 2] > 0.0 else -R[:, 2]
    return float(np.rad2deg(np.arctan2(-normal[1], normal[2]))), float(np.rad2deg(np.arctan2(-normal[0], normal[2])))
