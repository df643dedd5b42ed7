"""Calibration files from disk: one, two, or a folder that holds them."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from machine.lens import PRINCIPAL_OFFSET_MAX_FRAC, principal_off_frac
from machine.rotations import Array
from recording.files import read_text
from server.camera.rectification_formats import (
    is_euroc,
    is_kalibr,
    is_opencv,
    is_ros,
    parse_euroc,
    parse_kalibr,
    parse_opencv,
    parse_ros,
)
from server.camera.rectification_rig import CalibrationFileError, EyeCalibration, RigCalibration, checked_rig
from server.camera.rectification_yaml import Fields, parse_yaml
from server.camera.rectification_zed import is_zed, parse_zed

CALIBRATION_FILE_NAMES = (  # pairs looked for, in this order
    ("mav0/cam0/sensor.yaml", "mav0/cam1/sensor.yaml"),
    ("cam0/sensor.yaml", "cam1/sensor.yaml"),
    ("left.yaml", "right.yaml"),
    ("intrinsics.yml", "extrinsics.yml"),
    ("calib.txt",),
)


SUPPORTED_FORMATS_TEXT = (
    "a ZED's SNxxxx.conf, OpenCV's stereo YAML (one file, or intrinsics and extrinsics), two ROS camera_info YAML, two "
    "EuRoC sensor.yaml, a Kalibr camchain.yaml, or KITTI's calib.txt"
)


KITTI_LABEL_PATTERN = re.compile(r"^(P_rect_0|P)([0-3])\s*:\s*(.*)$")
NUMBER_PATTERN = re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$")
KITTI_CAMERA_PAIRS = ((0, 1), (2, 3))  # grey and colour


def is_kitti(text: str) -> bool:
    """Whether a text is projection matrices: labelled lines, or nothing but numbers."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    bare = bool(lines) and all(NUMBER_PATTERN.match(word) for line in lines for word in line.split())
    labelled = [found for line in lines if (found := KITTI_LABEL_PATTERN.match(line))]
    return bare or any(NUMBER_PATTERN.match(found[3].split()[0]) for found in labelled if found[3].strip())


def parse_kitti(text: str, file: str, size_px: tuple[int, int]) -> RigCalibration:
    """The rig of P0 and P1 (or P2 and P3, or P_rect_0x), or of two bare lines of 12 numbers.

    Model:   P = K [I | t]: baseline (P_left[0, 3] - P_right[0, 3]) / f. No lens, parallel eyes.
    Args:    size_px: of one eye; the file does not hold it.
    Source:  Geiger et al. 2013, Vision meets robotics: the KITTI dataset, section IV.
    """
    left, right = _parse_projection_matrices(text, file)
    if abs(left[0, 0] - right[0, 0]) > 1e-6 * abs(left[0, 0]) or left[0, 0] <= 0.0:
        raise CalibrationFileError(
            f"{file}: focal lengths {left[0, 0]:g} and {right[0, 0]:g} px differ; they must agree"
        )
    t = np.array([(right[0, 3] - left[0, 3]) / left[0, 0], 0.0, 0.0])
    eyes = [EyeCalibration(float(P[0, 0]), float(P[1, 1]), float(P[0, 2]), float(P[1, 2])) for P in (left, right)]
    return checked_rig(RigCalibration(eyes[0], eyes[1], np.eye(3), t, *size_px), file)


def _parse_projection_matrices(text: str, file: str) -> tuple[Array, Array]:
    found: dict[int, Array] = {}
    bare: list[Array] = []
    for number, line in enumerate(text.splitlines(), start=1):
        labelled = KITTI_LABEL_PATTERN.match(line.strip())
        if labelled:
            found[int(labelled[2])] = _parse_3x4_matrix(labelled[3], f"{file}: {labelled[1]}{labelled[2]}")
        elif line.strip() and NUMBER_PATTERN.match(line.split()[0]):
            bare.append(_parse_3x4_matrix(line, f"{file}: line {number}"))
    for left, right in KITTI_CAMERA_PAIRS:
        if left in found and right in found:
            return found[left], found[right]
    if len(bare) == 2:
        return bare[0], bare[1]
    raise CalibrationFileError(f"{file}: has {sorted(found)} of the projections P0 .. P3; give P0 and P1, or P2 and P3")


def _parse_3x4_matrix(text: str, subject: str) -> Array:
    words = text.split()
    if len(words) != 12 or not all(NUMBER_PATTERN.match(word) for word in words):
        raise CalibrationFileError(f"{subject} has {len(words)} words; give 3 x 4 numbers")
    return np.array(words, dtype=float).reshape(3, 4)


@dataclass(frozen=True, slots=True)
class CalibrationText:
    """One file: its name, for the errors, and its text."""

    name: str
    text: str


def parse_calibration(
    files: Sequence[CalibrationText], size_px: tuple[int, int], off_centre: bool = False
) -> RigCalibration:
    """The rig that one or two files describe.

    Args:    files: left before right where each eye has its own. size_px: width and height of one eye's images, for
             formats that hold several sizes (ZED) or none (KITTI, some OpenCV files). off_centre: confirms a principal
             point far from the middle.
    Returns: the rig, every number checked.
    Raises:  CalibrationFileError: file, field, value, remedy; also for a text of no known format.
    """
    if len(files) not in (1, 2):
        raise CalibrationFileError(f"calibration: {len(files)} files; give one or two: {SUPPORTED_FORMATS_TEXT}")
    plain = [CalibrationText(file.name, file.text.removeprefix("\ufeff")) for file in files]
    rig = _parse_rig_calibration(plain, size_px)
    for name, eye in (("left", rig.left), ("right", rig.right)):
        off_frac = principal_off_frac((eye.cx_px, eye.cy_px), (rig.width_px, rig.height_px))
        if off_frac > PRINCIPAL_OFFSET_MAX_FRAC and not off_centre:
            raise CalibrationFileError(
                f"{' and '.join(file.name for file in files)}: {name} eye: principal point ({eye.cx_px:g}, "
                f"{eye.cy_px:g}) px lies {100 * off_frac:.0f} % of {rig.width_px} x {rig.height_px} px from the middle "
                f"(limit {100 * PRINCIPAL_OFFSET_MAX_FRAC:g} %); give the calibration of this image size, or confirm a "
                "cropped picture with [camera] off_centre = true"
            )
    return rig


def _parse_rig_calibration(files: Sequence[CalibrationText], size_px: tuple[int, int]) -> RigCalibration:
    first = files[0]
    if first.text.lstrip().startswith("<"):
        raise CalibrationFileError(f"{first.name}: XML; save the calibration as YAML")
    if len(files) == 1 and is_zed(first.text):
        return parse_zed(first.text, first.name, size_px)
    if len(files) == 1 and is_kitti(first.text):
        return parse_kitti(first.text, first.name, size_px)
    parsed = [parse_yaml(file.text, file.name) for file in files]
    return _of_one(parsed[0], size_px) if len(parsed) == 1 else _of_two(parsed[0], parsed[1], size_px)


def _of_one(fields: Fields, size_px: tuple[int, int]) -> RigCalibration:
    if is_kalibr(fields):
        return parse_kalibr(fields)
    if is_opencv(fields):
        return parse_opencv(fields, size_px)
    if is_ros(fields) or is_euroc(fields):
        raise fields.refusal("one eye only; give the other eye's file as well, the left one first")
    raise fields.refusal(f"no calibration of a stereo rig; give {SUPPORTED_FORMATS_TEXT}")


def _of_two(left: Fields, right: Fields, size_px: tuple[int, int]) -> RigCalibration:
    if is_ros(left) and is_ros(right):
        return parse_ros(left, right)
    if is_euroc(left) and is_euroc(right):
        return parse_euroc(left, right)
    merged = Fields(f"{left.file} and {right.file}", {**left.tree, **right.tree})
    if is_opencv(merged):
        return parse_opencv(merged, size_px)
    raise merged.refusal(f"no calibration of a stereo rig together; give {SUPPORTED_FORMATS_TEXT}")


def read_calibration(paths: Sequence[str], size_px: tuple[int, int], off_centre: bool = False) -> RigCalibration:
    """The rig of one or two files, or of a folder with EuRoC's, ROS', OpenCV's or KITTI's files.

    Args:    off_centre: a principal point far from the middle is right.
    Raises:  CalibrationFileError: file, field, remedy.
    """
    files = (
        _in_folder(Path(paths[0])) if len(paths) == 1 and Path(paths[0]).is_dir() else [Path(path) for path in paths]
    )
    return parse_calibration(
        [CalibrationText(str(file), _read_calibration_text(file)) for file in files], size_px, off_centre
    )


def _in_folder(folder: Path) -> list[Path]:
    for names in CALIBRATION_FILE_NAMES:
        files = [folder / name for name in names]
        if all(file.is_file() for file in files):
            return files
    looked = ", ".join(" + ".join(names) for names in CALIBRATION_FILE_NAMES)
    raise CalibrationFileError(f"calibration folder {folder}: none of {looked}; give the files themselves")


def _read_calibration_text(file: Path) -> str:
    try:
        return read_text(file)
    except OSError as error:
        raise CalibrationFileError(
            f"calibration file {file}: {error.strerror}; give a calibration file that can be read"
        ) from error
