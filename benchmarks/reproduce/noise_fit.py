"""Fits the noise model to rendered runs, and tells whether the fast world then errs as the rendered one does."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import ks_2samp, kstwobign

from benchmarks.reproduce.noise_model import CornerNoise
from benchmarks.reproduce.rendered_looks import RenderedLook
from benchmarks.reproduce.true_corners import EYES
from machine.camera import project_stereo
from machine.description import Machine
from machine.markers import marker_corners
from machine.poses import inverse_pose, transform_points
from machine.rotations import Array, rotvec_from_rotation

POSE_FREEDOMS = 6
_MEDIAN_OF_CHI2 = 5.3481 / POSE_FREEDOMS
LOOKS_MIN = 8


class TooFewLooksError(ValueError):
    """Not enough rendered looks for a fit."""


@dataclass(frozen=True, slots=True)
class Agreement:
    """Rendered against fast errors on one axis: KS distance and p, ratio of standard deviations, means [SI]."""

    axis: str
    ks: float
    p: float
    sd_ratio: float
    mean_rendered: float
    mean_fast: float
    sd_rendered: float
    n: int


def fit_corner_noise(looks: Sequence[RenderedLook], machine: Machine) -> CornerNoise:
    """Corner noise of one object and one source from poses alone.

    Model:   a pose error moves the object's corners by D (N coordinates); with corner noise of variance s^2 and the
             least-squares pose E|D|^2 = 6 s^2, whatever distance, tilt and number of markers. Scatter in a look gives
             frame_px, a look's mean gives look_px^2 + frame_px^2 / n after outward and shift are taken out by least
             squares. Means are taken by the median, so that flipped poses do not count.
    Args:    looks: of one object and source, at least 8.
    Returns: the noise.
    Raises:  TooFewLooksError.
    """
    if len(looks) < LOOKS_MIN:
        raise TooFewLooksError(f"{len(looks)} looks, at least {LOOKS_MIN} needed; render more standpoints or seeds")
    fields = [_displacements(look, machine) for look in looks]
    means = [moved.mean(axis=0) for moved, _ in fields]
    bias = _constant_part(means, [radial for _, radial in fields])
    frames, lasting = [], []
    for (moved, radial), mean in zip(fields, means, strict=True):
        n = len(moved)
        scatter = np.sum((moved - mean) ** 2, axis=(1, 2)) * n / (n - 1) / POSE_FREEDOMS
        frames += scatter.tolist()
        lasting.append(float(np.sum((mean - _pattern(radial, bias)) ** 2)) / POSE_FREEDOMS)
    frame = _robust_mean(frames)
    look = _robust_mean(lasting) - frame / np.mean([len(moved) for moved, _ in fields])
    return CornerNoise(float(np.sqrt(frame)), float(np.sqrt(max(look, 0.0))), *(float(b) for b in bias))


def _displacements(look: RenderedLook, machine: Machine) -> tuple[Array, Array]:
    """How far measured poses move the corners from where exact ones have them: (n, N, 2) [px]; radial units (N, 2)."""
    exact = _pixels(look.T_cam_exact, look, machine)
    moved = np.array([_pixels(T, look, machine) - exact for T in look.Ts_cam_measured])
    quads = exact.reshape(-1, 4, 2)
    radial = quads - quads.mean(axis=1, keepdims=True)
    radial = np.sqrt(2.0) * radial / np.linalg.norm(radial, axis=2, keepdims=True)
    return moved, radial.reshape(-1, 2)


def _pixels(T_cam_object: Array, look: RenderedLook, machine: Machine) -> Array:
    """Corners (N, 2) [px] of the markers and eyes that the look rests on."""
    markers = {marker.marker_id: marker for marker in machine.markers_on(look.on)}
    quads = []
    for marker_id, eye in look.seen:
        marker = markers[marker_id]
        points = transform_points(T_cam_object @ marker.T_on_marker, marker_corners(marker.side_m))
        quads.append(project_stereo(machine.camera, points)[EYES.index(eye)])
    return np.concatenate(quads)


def _pattern(radial: Array, bias: Array) -> Array:
    return bias[0] * radial + bias[1:]


def _constant_part(means: list[Array], radials: list[Array]) -> Array:
    """(outward, shift x, shift y) [px], the median over looks of each look's own least squares."""
    each = []
    for mean, radial in zip(means, radials, strict=True):
        A = np.zeros((mean.size, 3))
        A[:, 0] = radial.ravel()
        A[0::2, 1], A[1::2, 2] = 1.0, 1.0
        each.append(np.linalg.lstsq(A, mean.ravel(), rcond=None)[0])
    return np.median(each, axis=0)


def _robust_mean(squares: Sequence[float]) -> float:
    """Mean of chi-square over its 6 degrees of freedom by its median, so that flips do not count."""
    return float(np.median(squares)) / _MEDIAN_OF_CHI2


def pose_errors(T_cam_measured: Array, T_cam_true: Array) -> Array:
    """(6,): rotation in the object's axes (tilt, tilt, roll) [rad], position in camera axes [m]."""
    turn = rotvec_from_rotation(inverse_pose(T_cam_true)[:3, :3] @ T_cam_measured[:3, :3])
    return np.concatenate((turn, T_cam_measured[:3, 3] - T_cam_true[:3, 3]))


AXES = ("tilt x", "tilt y", "roll", "x", "y", "z")


def agreement(rendered: Array, fast: Array, n_independent: int | None = None) -> tuple[Agreement, ...]:
    """Axis by axis, whether two sets of pose errors (n, 6), (m, 6) come from the same distribution.

    `n_independent`: how many of the rendered ones count as independent (the looks of one machine share their errors);
    p is that of the KS distance with so many.
    """
    n = len(rendered) if n_independent is None else n_independent
    rows = []
    for k, axis in enumerate(AXES):
        a, b = rendered[:, k], fast[:, k]
        statistic = float(np.asarray(ks_2samp(a, b), dtype=float)[0])
        p_value = float(kstwobign.sf(statistic * np.sqrt(n * len(b) / (n + len(b)))))
        ratio = _robust_sd(b) / max(_robust_sd(a), 1e-12)
        rows.append(
            Agreement(axis, statistic, p_value, ratio, float(np.median(a)), float(np.median(b)),
                      _robust_sd(a), len(a))
        )  # fmt: skip
    return tuple(rows)


def _robust_sd(values: Array) -> float:
    low, high = np.percentile(values, [15.87, 84.13])
    return 0.5 * float(high - low)
