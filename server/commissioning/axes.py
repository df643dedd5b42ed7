"""Which way the camera really looks: seen displacements against expected ones, a wrong mounting in words. Pure."""

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from machine.rotations import Array
from server.commissioning.contracts import Figure

ANGLE_MAX_DEG = 25.0  # as far as calibration may correct the nominal mounting
RATIO_MIN, RATIO_MAX = 0.8, 1.25  # of lengths: baseline, focal length
DEPTH_OFF_MAX_FRAC = 0.03  # 3 sigma: legs of 80 mm to 0.5 mm, and 0.5 % of uncalibrated kinematics
_CLEARLY = 0.7  # the best wrong mounting must fit this well before it is named
_AXES = ("right", "down", "forward")
_Rows = tuple[tuple[int, int], ...]  # of a signed permutation: source axis and sign
_KNOWN: dict[_Rows, str] = {
    ((0, -1), (1, -1), (2, 1)): "the camera is mounted upside down (turned by 180 deg about its line of sight)",
    ((0, -1), (1, 1), (2, 1)): "left and right are mirrored or swapped",
    ((0, 1), (1, -1), (2, 1)): "the pictures are flipped top to bottom",
    ((0, -1), (1, 1), (2, -1)): "the camera looks backwards",
    ((1, 1), (0, -1), (2, 1)): "the camera is turned by 90 deg about its line of sight",
    ((1, -1), (0, 1), (2, 1)): "the camera is turned by -90 deg about its line of sight",
}


@dataclass(frozen=True, slots=True)
class Seen:
    """Camera displacements of some moves in the nominal camera's axes (k, 3) [m]: by kinematics, and as seen."""

    by: str
    expected: Array
    seen: Array


def axes_figures(seen: Seen, legs: list[str]) -> list[Figure]:
    """Angle and length of every seen displacement against the expected one."""
    figures = []
    for leg, wanted, got in zip(legs, seen.expected, seen.seen, strict=True):
        length, got_length = float(np.linalg.norm(wanted)), float(np.linalg.norm(got))
        cosine = float(wanted @ got) / max(length * got_length, 1e-12)
        angle = float(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))))
        figures.append(Figure(f"{leg}, by {seen.by}: off the expected direction", angle, "deg", at_most=ANGLE_MAX_DEG))
        ratio = got_length / max(length, 1e-12)
        figures.append(Figure(f"{leg}, by {seen.by}: measured length", ratio, "of expected", RATIO_MIN, RATIO_MAX))
    return figures


def depth_figure(seen: Seen) -> list[Figure]:
    """Depth seen against sideways seen, each over the encoders' way: the common focal length over its file's, inverted.

    Model:   depth is f b / disparity and sideways is free of f, so their ratio alone shows a focal length that is off
             alike in both eyes. None without a leg along depth and one across.
    """
    ratios = np.linalg.norm(seen.seen, axis=1) / np.maximum(np.linalg.norm(seen.expected, axis=1), 1e-12)
    along = np.abs(seen.expected[:, 2]) > np.linalg.norm(seen.expected[:, :2], axis=1)
    if along.all() or not along.any():
        return []
    value = float(np.mean(ratios[along]) / np.mean(ratios[~along]))
    limits = 1.0 - DEPTH_OFF_MAX_FRAC, 1.0 + DEPTH_OFF_MAX_FRAC
    return [Figure(f"depth against sideways, by {seen.by} (focal length)", value, "of expected", *limits)]


def wrong_mounting(seen: Seen) -> str:
    """What signed permutation of the axes explains what was seen, in words; empty: none, or none is needed.

    Model:   the P among the 48 signed permutations that maximises sum (P expected) . seen over the product of lengths.
    """
    best, fit = _best_permutation(seen.expected, seen.seen)
    if fit < _CLEARLY or best == ((0, 1), (1, 1), (2, 1)):
        return ""
    exchanged = "; ".join(f"{_AXES[i]} shows as {_signed(best, i)}" for i in range(3) if best[i] != (i, 1))
    return _KNOWN.get(best, f"the camera's axes are exchanged: {exchanged}")


def _signed(best: _Rows, axis: int) -> str:
    """As what a nominal axis shows in the real camera."""
    for row, (source, sign) in enumerate(best):
        if source == axis:
            return ("" if sign > 0 else "minus ") + _AXES[row]
    raise ValueError(f"axis {axis} is in no row of {best}")


def _best_permutation(expected: Array, seen: Array) -> tuple[_Rows, float]:
    """Rows (source axis, sign) of the best signed permutation, and its mean cosine."""
    norm = float(np.linalg.norm(expected, axis=1) @ np.linalg.norm(seen, axis=1))
    scored = []
    for order, signs in product(permutations(range(3)), product((1, -1), repeat=3)):
        turned = expected[:, order] * np.array(signs)
        scored.append((float(np.sum(turned * seen)) / max(norm, 1e-12), tuple(zip(order, signs, strict=True))))
    fit, rows = max(scored, key=lambda each: each[0])
    return rows, fit
