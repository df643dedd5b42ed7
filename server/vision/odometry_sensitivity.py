"""What errors that all points of a keyframe share, and the velocity's error, do to a fitted pose."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from server.vision.contracts import Array
from server.vision.odometry_keyframe import Keyframe
from server.vision.odometry_motion import inverse_jacobian
from server.vision.odometry_observation import ObservedPoints
from server.vision.odometry_pose import PoseFit, stacked_rays, white_rows
from server.vision.small_algebra import apply

Indices = NDArray[np.int64]
N_SHARED_ERRORS = 12  # errors of a keyframe: its pose (6, left perturbation in vo), then its velocity (6, its own axes)


@dataclass(frozen=True, slots=True)
class Sensitivity:
    """Gains on the perturbation (6,) of T_vo_cam: of_keyframes (k, 6, 12): of the shared errors of each keyframe in
    keyframe_indices (k,); of_twist (6, 6): of the present velocity's error; of_readout (6,) [per s].

    What the pair says of the readout itself: `readout_information` [1/s^2], and its best change `readout_step_s`.
    """

    keyframe_indices: tuple[int, ...]
    of_keyframes: Array
    of_twist: Array
    of_readout: Array
    readout_information: float
    readout_step_s: float


@dataclass(frozen=True, slots=True)
class Shutter:
    """What the shutter did to n points: where their rows lie in the readout, here and in their keyframes (n,); this
    camera's velocity (6,), and how long the readout may well be [s]."""

    row_fractions: Array
    fractions_key: Array
    twist: Array
    readout_s: float


@njit(cache=True, nogil=True)
def _rotation_jacobian_rows(column: Array, point: Array, out: Array) -> None:
    """d(w x point) / dw projected on rows (4, 3): rows [-[point]x], in place (4, 3)."""
    for a in range(4):
        out[a, 0] = point[1] * column[a, 2] - point[2] * column[a, 1]
        out[a, 1] = point[2] * column[a, 0] - point[0] * column[a, 2]
        out[a, 2] = point[0] * column[a, 1] - point[1] * column[a, 0]


@njit(cache=True, nogil=True)
def _shared_columns(
    slope: Array,
    rotation: Array,
    point_cam: Array,
    point_vo: Array,
    T: Array,
    mixing: Array,
    twist_key: Array,
    twist: Array,
    fractions: tuple[float, float, float],
    out: Array,
) -> None:
    """d(four coordinates) / d(keyframe pose 6, keyframe velocity 6, velocity 6, readout), (4, 19), in place.

    `mixing` (3, 3): how far the point goes with this keyframe (identity: wholly).
    """
    here, there, readout = fractions
    in_vo, in_key, turn = np.zeros((4, 3)), np.zeros((4, 3)), np.zeros((4, 3))
    away, point_key = point_vo - T[:3, 3], np.zeros(3)
    for k in range(3):
        point_key[k] = T[0, k] * away[0] + T[1, k] * away[1] + T[2, k] * away[2]
    for a in range(4):
        for k in range(3):
            turn[a, k] = slope[a, 0] * rotation[0, k] + slope[a, 1] * rotation[1, k] + slope[a, 2] * rotation[2, k]
        for k in range(3):
            in_vo[a, k] = turn[a, 0] * mixing[0, k] + turn[a, 1] * mixing[1, k] + turn[a, 2] * mixing[2, k]
        for k in range(3):
            in_key[a, k] = in_vo[a, 0] * T[0, k] + in_vo[a, 1] * T[1, k] + in_vo[a, 2] * T[2, k]
    _rotation_jacobian_rows(in_vo, away, turn)
    out[:, 0:3], out[:, 3:6] = turn, in_vo
    _rotation_jacobian_rows(in_key, point_key, turn)
    out[:, 6:9], out[:, 9:12] = there * turn, there * in_key
    _rotation_jacobian_rows(slope, point_cam, turn)
    out[:, 12:15], out[:, 15:18] = -here * turn, -here * slope
    for a in range(4):
        out[a, 18] = 0.0
        for k in range(6):
            out[a, 18] += out[a, 6 + k] * twist_key[k] + out[a, 12 + k] * twist[k]
            out[a, 6 + k] *= readout
            out[a, 12 + k] *= readout


@njit(cache=True, nogil=True)
def _sensitivity_products(
    rotation: Array,
    position: Array,
    points: Array,
    rays: Array,
    roots: Array,
    shape: Array,
    fractions: Array,
    twist: Array,
    readout: float,
    hosts: Indices,
    mixings: Array,
    Ts_vo_key: Array,
    twists_key: Array,
) -> tuple[Array, Array, Array]:
    """Sums of J^T C^-1 J_shared per keyframe slot (k, 6, 12), of J^T C^-1 (velocity, readout) (6, 7), and of
    J_readout^T C^-1 (J_readout, residual) (2,)."""
    keyed, moving, alone = np.zeros((len(Ts_vo_key), 6, 12)), np.zeros((6, 7)), np.zeros(2)
    rows, slope, white, shared = np.zeros((4, 6)), np.zeros((4, 3)), np.zeros(4), np.zeros((4, 19))
    for i in range(len(points)):
        arm = apply(rotation, points[i])
        point_cam = arm + position
        white_rows(arm, point_cam, rays[i], roots[i], shape, rows, slope, white)
        for slot in range(len(Ts_vo_key)):
            is_host = slot == hosts[i]
            mixing = mixings[i, slot]
            if not is_host and mixing[0, 0] == 0.0 and mixing[1, 1] == 0.0 and mixing[2, 2] == 0.0:
                continue
            moment = (fractions[i, 0], fractions[i, 1] if is_host else 0.0, readout)
            T, twist_key = Ts_vo_key[slot], twists_key[slot]
            _shared_columns(slope, rotation, point_cam, points[i], T, mixing, twist_key, twist, moment, shared)
            for a in range(4):
                readout_row = 0.0
                for b in range(a + 1):
                    weight = roots[i, a, b]
                    if weight == 0.0:
                        continue
                    readout_row += weight * shared[b, 18]
                    for j in range(6):
                        scaled = weight * rows[a, j]
                        for k in range(12):
                            keyed[slot, j, k] += scaled * shared[b, k]
                        if is_host:
                            for k in range(7):
                                moving[j, k] += scaled * shared[b, 12 + k]
                if is_host:
                    alone[0] += readout_row * readout_row
                    alone[1] += readout_row * white[a]
    return keyed, moving, alone


def keyframe_mixture(keyframes: Sequence[Keyframe], hosts: Indices, indices: Indices) -> tuple[Indices, Array]:
    """Numbers (k,) of the keyframes that these points (n,) go with, and how far they do, (n, k, 3, 3)."""
    serials = {keyframe.serial: number for number, keyframe in enumerate(keyframes)}
    used = {int(host) for host in np.unique(hosts)}
    for host in tuple(used):
        used |= {serials[serial] for serial in keyframes[host].keyframe_influence if serial in serials}
    numbers = np.array(sorted(used), dtype=np.int64)
    mixings = np.zeros((len(hosts), len(numbers), 3, 3))
    for host in np.unique(hosts):
        on = hosts == host
        for serial, mixing in keyframes[host].keyframe_influence.items():
            if serial in serials:
                mixings[on, np.searchsorted(numbers, serials[serial])] = mixing[indices[on]]
    return numbers, mixings


def fit_sensitivity(
    observed: ObservedPoints, fit: PoseFit, points_vo: Array, shutter: Shutter, keyframes: Sequence[Keyframe]
) -> Sensitivity:
    """How a fit follows the errors that its points share.

    Model:   gain = -(J^T C^-1 J)^-1 J^T C^-1 J_shared (a consider, or Schmidt, analysis). The readout's own step is
             that of a Gauss-Newton step for pose and readout together.
    Args:    points_vo: as fitted (n, 3). keyframes: all, as `observed.keyframe_indices` numbers them.
    """
    on = fit.inliers
    hosts, indices, seen = observed.keyframe_indices[on], observed.indices[on], observed.stereo_points
    numbers, mixings = keyframe_mixture(keyframes, hosts, indices)
    keyed, moving, alone = _sensitivity_products(
        np.ascontiguousarray(fit.T_cam_vo[:3, :3]),
        np.ascontiguousarray(fit.T_cam_vo[:3, 3]),
        np.ascontiguousarray(points_vo[on]),
        stacked_rays(seen)[on],
        fit.whitening_matrices[on],
        np.array([seen.focal_px, seen.baseline_m]),
        np.column_stack([shutter.row_fractions, shutter.fractions_key])[on],
        shutter.twist,
        shutter.readout_s,
        np.searchsorted(numbers, hosts),
        mixings,
        np.array([keyframes[number].T_vo_cam for number in numbers]),
        np.array([keyframes[number].twist for number in numbers]),
    )
    inverse = np.linalg.inv(fit.information)
    to_vo = -inverse_jacobian(fit.T_cam_vo) @ inverse
    crossed = moving[:, 6]
    information = float(alone[0] - crossed @ inverse @ crossed)
    return Sensitivity(
        keyframe_indices=tuple(int(number) for number in numbers),
        of_keyframes=to_vo @ keyed,
        of_twist=to_vo @ moving[:, :6],
        of_readout=to_vo @ crossed,
        readout_information=max(information, 0.0) / fit.noise_factor**2,
        readout_step_s=float(-alone[1] / information) if information > 1.0 else 0.0,
    )
