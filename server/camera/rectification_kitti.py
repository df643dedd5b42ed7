"""Calibrations of KITTI, whose images are rectified already: projection matrices -> rig. Pure."""

import re

import numpy as np

from machine.rotations import Array
from server.camera.rectification_rig import CalibrationFileError, EyeCalibration, RigCalibration, checked_rig

LABEL = re.compile(r"^(P_rect_0|P)([0-3])\s*:\s*(.*)$")
NUMBER = re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$")
PAIRS = ((0, 1), (2, 3))  # grey and colour


def is_kitti(text: str) -> bool:
    """Whether a text is projection matrices: labelled lines, or nothing but numbers."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    bare = bool(lines) and all(NUMBER.match(word) for line in lines for word in line.split())
    labelled = [found for line in lines if (found := LABEL.match(line))]
    return bare or any(NUMBER.match(found[3].split()[0]) for found in labelled if found[3].strip())


def parse_kitti(text: str, file: str, size_px: tuple[int, int]) -> RigCalibration:
    """The rig of P0 and P1 (or P2 and P3, or P_rect_0x), or of two bare lines of 12 numbers.

    Model:   P = K [I | t]: baseline (P_left[0, 3] - P_right[0, 3]) / f. No lens, parallel eyes.
    Args:    size_px: of one eye; the file does not tell it.
    Raises:  CalibrationFileError: file, field, remedy.
    Source:  Geiger et al. 2013, Vision meets robotics: the KITTI dataset, section IV.
    """
    left, right = _pair(text, file)
    if abs(left[0, 0] - right[0, 0]) > 1e-6 * abs(left[0, 0]) or left[0, 0] <= 0.0:
        raise CalibrationFileError(
            f"{file}: focal lengths {left[0, 0]:g} and {right[0, 0]:g} px differ; they must agree"
        )
    t = np.array([(right[0, 3] - left[0, 3]) / left[0, 0], 0.0, 0.0])
    eyes = [EyeCalibration(float(P[0, 0]), float(P[1, 1]), float(P[0, 2]), float(P[1, 2])) for P in (left, right)]
    return checked_rig(RigCalibration(eyes[0], eyes[1], np.eye(3), t, *size_px), file)


def _pair(text: str, file: str) -> tuple[Array, Array]:
    found: dict[int, Array] = {}
    bare: list[Array] = []
    for number, line in enumerate(text.splitlines(), start=1):
        labelled = LABEL.match(line.strip())
        if labelled:
            found[int(labelled[2])] = _matrix(labelled[3], f"{file}: {labelled[1]}{labelled[2]}")
        elif line.strip() and NUMBER.match(line.split()[0]):
            bare.append(_matrix(line, f"{file}: line {number}"))
    for left, right in PAIRS:
        if left in found and right in found:
            return found[left], found[right]
    if len(bare) == 2:
        return bare[0], bare[1]
    raise CalibrationFileError(f"{file}: has {sorted(found)} of the projections P0 .. P3; give P0 and P1, or P2 and P3")


def _matrix(text: str, subject: str) -> Array:
    words = text.split()
    if len(words) != 12 or not all(NUMBER.match(word) for word in words):
        raise CalibrationFileError(f"{subject} has {len(words)} words; give 3 x 4 numbers")
    return np.array(words, dtype=float).reshape(3, 4)
