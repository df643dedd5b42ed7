"""What the corners of one look say of lens and prints beyond the poses: perspective, and stereo against printed sides.

A tilted marker of known size looks differently by another focal length, and the eyes' own range contradicts a wrong
print. Poses alone do not carry that, so a look brings it along as information on the lens unknowns.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from machine.description import Machine, Marker
from machine.poses import transform_points
from server.calibration.contracts import Array
from server.calibration.joint_lens import (
    FOCAL,
    FOCAL_DOUBT_SIGMAS,
    FOCAL_SIGMA_GOOD_FRAC,
    N_LENS,
    OOI_PRINT,
    TOOL_PRINT,
    LensPrior,
    both_pixels,
    corners_of,
    layout_effects,
    pixel_changes,
    pose_jacobian,
)

SIGMA_CORNER_PX = 0.1  # of one corner coordinate, the same in all pairs of a look: print, lens and edge fit
CornersPx = Mapping[int, tuple[Array | None, Array | None]]  # by marker: (4, 2) [raw px] in the left and right eye


@dataclass(frozen=True, slots=True)
class LensEvidence:
    """Information (7, 7) on the lens unknowns and information times their values (7,)."""

    information: Array
    information_vector: Array


def lens_evidence(
    machine: Machine, T_cam_tool: Array, T_cam_ooi: Array, corners_px: CornersPx, prior: LensPrior
) -> LensEvidence:
    """The evidence of one look.

    Model:   r = J d pose + G lens + layout + noise, in px; W = (sigma^2 I + E E^T)^-1 with E the layout's effects.
             The pose is eliminated: information G^T M G, vector G^T M r, M = W - W J (J^T W J)^-1 J^T W; both over
             the mean square of what is left, where that is above 1.
    Args:    poses as measured; corners_px: of each marker, mean over the look.
    """
    information, vector = np.zeros((N_LENS, N_LENS)), np.zeros(N_LENS)
    tool, ooi = machine.markers_on("tool"), machine.markers_on("ooi")
    for own, T, printed in ((tool, T_cam_tool, TOOL_PRINT), (ooi, T_cam_ooi, OOI_PRINT)):
        markers = [marker for marker in own if marker.marker_id in corners_px]
        if markers:
            found = _of_object(machine, markers, T, printed, corners_px, prior)
            information, vector = information + found.information, vector + found.information_vector
    return LensEvidence(information, vector)


def _of_object(
    machine: Machine, markers: Sequence[Marker], T: Array, printed: int, corners_px: CornersPx, prior: LensPrior
) -> LensEvidence:
    camera, points = machine.camera, corners_of(markers)
    seen = np.vstack([_both_eyes(*corners_px[marker.marker_id]) for marker in markers]).ravel()
    residual = seen - both_pixels((camera, camera), transform_points(T, points))
    rows = np.isfinite(residual)
    if rows.sum() <= 6:
        return LensEvidence(np.zeros((N_LENS, N_LENS)), np.zeros(N_LENS))
    E = layout_effects(camera, T, markers, prior)[rows]
    J, G = pose_jacobian(camera, T, points)[rows], pixel_changes(camera, T, markers, printed)[rows]
    W = np.linalg.inv(SIGMA_CORNER_PX**2 * np.eye(int(rows.sum())) + E @ E.T)
    M = W - W @ J @ np.linalg.pinv(J.T @ W @ J) @ J.T @ W
    information, vector, r = G.T @ M @ G, G.T @ M @ residual[rows], residual[rows]
    freedoms = max(1, int(rows.sum()) - 6 - N_LENS)
    left = float(r @ M @ r - vector @ np.linalg.pinv(information, hermitian=True) @ vector) / freedoms
    worth = 1.0 / max(1.0, left)  # what no lens explains, such as a covered side, makes the corners worth less
    return LensEvidence(0.5 * worth * (information + information.T), worth * vector)


def _both_eyes(left: Array | None, right: Array | None) -> Array:
    """(4, 4): u, v left, u, v right [px]; NaN where an eye does not see it."""
    nothing = np.full((4, 2), np.nan)
    return np.hstack([nothing if left is None else left, nothing if right is None else right])


def mean_evidence(found: Sequence[LensEvidence]) -> LensEvidence:
    """Of several looks as of one: what spoils a corner (its print, its edge) is in all of them. None: no evidence."""
    if not found:
        return LensEvidence(np.zeros((N_LENS, N_LENS)), np.zeros(N_LENS))
    information = np.mean([look.information for look in found], axis=0)
    return LensEvidence(information, np.mean([look.information_vector for look in found], axis=0))


def lens_doubts(lens: Array, covariance: Array, prior: LensPrior) -> list[str]:
    """Focal length and prints that are refuted, with the figure and the remedy.

    Model:   an estimate departs from 0 by chance with the variance prior less posterior; beyond 3 sigma once in 370.
             A right focal length departs by what a careful calibration leaves, and by the estimate's own sigma.
    """
    sigma, believed = np.sqrt(np.diag(covariance)), prior.sigma
    found = []
    for name, index, remedy in (
        ("camera focal length", FOCAL, "calibrate the camera"),
        ("tool marker print", TOOL_PRINT, "measure the printed side and correct side_m in the machine file"),
        ("OOI marker print", OOI_PRINT, "measure the printed sides and correct side_m in the machine file"),
    ):
        chance = np.sqrt(max(believed[index] ** 2 - sigma[index] ** 2, 1e-18))
        if index == FOCAL:
            chance = float(np.hypot(sigma[index], FOCAL_SIGMA_GOOD_FRAC))
        if abs(lens[index]) > FOCAL_DOUBT_SIGMAS * chance:
            off, known = 100.0 * lens[index], 100.0 * sigma[index]
            found.append(f"{name} {off:+.2f} +- {known:.2f} % against the file: {remedy}")
    return found
