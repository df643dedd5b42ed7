"""How well pictures of a board cover what a lens has to be known for, and what to photograph next."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from server.calibration.contracts import Array
from server.calibration.lens_fit import BoardView, LensFit

COLUMNS, ROWS = 8, 6
TILT_MIN_DEG = 20.0
TILTED_MIN = 3  # views tilted that far to each of four sides
RANGE_MIN = 1.6  # farthest over nearest
FOCAL_SIGMA_MAX_FRAC = 1e-3
VIEWS_GOOD = 15
CELLS = ("left", "middle", "right"), ("top", "middle", "bottom")


@dataclass(frozen=True, slots=True)
class Coverage:
    """Corners in each part of each eye's picture (eyes, ROWS, COLUMNS), and what to photograph next."""

    corners: NDArray[np.int64]
    advice: tuple[str, ...]


def coverage_of(views: list[BoardView], fit: LensFit) -> Coverage:
    """The coverage of the used views. Args: views: all of them; those that the fit dropped do not count."""
    used = [view for view in views if view.name in set(fit.used)]
    width, height = fit.size_px
    counts = np.zeros((len(fit.lenses), ROWS, COLUMNS), dtype=np.int64)
    for view in used:
        for eye, seen in enumerate(view.eyes):
            if seen is not None:
                u = np.clip((seen[1][:, 0] / width * COLUMNS).astype(int), 0, COLUMNS - 1)
                v = np.clip((seen[1][:, 1] / height * ROWS).astype(int), 0, ROWS - 1)
                np.add.at(counts[eye], (v, u), 1)
    return Coverage(counts, tuple(_advice(counts, fit)))


def _advice(counts: NDArray[np.int64], fit: LensFit) -> list[str]:
    out = []
    empty = (counts == 0).any(axis=0)
    if empty.any():
        places = sorted({_place(row, column) for row, column in np.argwhere(empty)})
        out.append(f"hold the board into the {', '.join(places)} of the picture: no corner was seen there")
    tilts = np.array([_tilt_deg(board) for board in fit.boards])
    for axis, sides in ((0, ("its top", "its bottom")), (1, ("its left side", "its right side"))):
        for sign, side in zip((1.0, -1.0), sides, strict=True):
            count = int(np.sum(sign * tilts[:, axis] > TILT_MIN_DEG))
            if count < TILTED_MIN:
                out.append(
                    f"tilt the board by 30 to 45 deg with {side} away from the camera: {count} of {TILTED_MIN} views"
                )
    distances = np.linalg.norm(fit.boards[:, 3:], axis=1)
    if distances.max() < RANGE_MIN * distances.min():
        near, far = 1e3 * distances.min(), 1e3 * distances.max()
        out.append(f"go nearer and farther: all views lie between {near:.0f} and {far:.0f} mm")
    sigma = float(np.sqrt(fit.covariance[0, 0]) / fit.lenses[0, 0])
    if sigma > FOCAL_SIGMA_MAX_FRAC and not out:
        out.append(
            f"more views: the focal length is known to {100 * sigma:.2f} %, {100 * FOCAL_SIGMA_MAX_FRAC:.1f} % is good"
        )
    if len(fit.used) < VIEWS_GOOD:
        out.append(f"{len(fit.used)} views are used, {VIEWS_GOOD} are good")
    return out


def _place(row: int, column: int) -> str:
    across = CELLS[0][0 if column < 3 else 2 if column > 4 else 1]
    down = CELLS[1][0 if row < 2 else 2 if row > 3 else 1]
    return "middle" if across == down == "middle" else f"{down} {across}".replace("middle ", "").replace(" middle", "")


def _tilt_deg(board: Array) -> tuple[float, float]:
    """How far the board's normal leans [deg]: positive with its top, and with its left side, away from the camera."""
    R, _ = cv2.Rodrigues(np.ascontiguousarray(board[:3]))
    normal = R[:, 2] if R[2, 2] > 0.0 else -R[:, 2]
    return float(np.rad2deg(np.arctan2(-normal[1], normal[2]))), float(np.rad2deg(np.arctan2(-normal[0], normal[2])))
