"""Any known stereo calibration: texts of files -> rig. Which format it is, the text tells. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass

from machine.lens import PRINCIPAL_OFF_MAX_FRAC, principal_off_frac
from server.camera.rectification_euroc import is_euroc, is_kalibr, parse_euroc, parse_kalibr
from server.camera.rectification_kitti import is_kitti, parse_kitti
from server.camera.rectification_opencv import is_opencv, parse_opencv
from server.camera.rectification_rig import CalibrationFileError, EyeCalibration, RigCalibration
from server.camera.rectification_ros import is_ros, parse_ros
from server.camera.rectification_yaml import Tree, parse_yaml
from server.camera.rectification_zed import is_zed, parse_zed

__all__ = ["CalibrationFileError", "CalibrationText", "EyeCalibration", "RigCalibration", "parse_calibration"]

KNOWN = (
    "a ZED's SNxxxx.conf, OpenCV's stereo YAML (one file, or intrinsics and extrinsics), two ROS camera_info YAML, two "
    "EuRoC sensor.yaml, a Kalibr camchain.yaml, or KITTI's calib.txt"
)


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
        raise CalibrationFileError(f"calibration: {len(files)} files; give one or two: {KNOWN}")
    plain = [CalibrationText(file.name, file.text.removeprefix("\ufeff")) for file in files]
    rig = _parsed(plain, size_px)
    for name, eye in (("left", rig.left), ("right", rig.right)):
        off_frac = principal_off_frac((eye.cx_px, eye.cy_px), (rig.width_px, rig.height_px))
        if off_frac > PRINCIPAL_OFF_MAX_FRAC and not off_centre:
            raise CalibrationFileError(
                f"{' and '.join(file.name for file in files)}: {name} eye: principal point ({eye.cx_px:g}, "
                f"{eye.cy_px:g}) px lies {100 * off_frac:.0f} % of {rig.width_px} x {rig.height_px} px from the middle "
                f"(limit {100 * PRINCIPAL_OFF_MAX_FRAC:g} %); give the calibration of this image size, or confirm a "
                "cropped picture with [camera] off_centre = true"
            )
    return rig


def _parsed(files: Sequence[CalibrationText], size_px: tuple[int, int]) -> RigCalibration:
    first = files[0]
    if first.text.lstrip().startswith("<"):
        raise CalibrationFileError(f"{first.name}: XML; save the calibration as YAML")
    if len(files) == 1 and is_zed(first.text):
        return parse_zed(first.text, first.name, size_px)
    if len(files) == 1 and is_kitti(first.text):
        return parse_kitti(first.text, first.name, size_px)
    trees = [parse_yaml(file.text, file.name) for file in files]
    names = tuple(file.name for file in files)
    return _of_one(trees[0], names[0], size_px) if len(trees) == 1 else _of_two(trees, (names[0], names[1]), size_px)


def _of_one(tree: Tree, name: str, size_px: tuple[int, int]) -> RigCalibration:
    if is_kalibr(tree):
        return parse_kalibr(tree, name)
    if is_opencv(tree):
        return parse_opencv(tree, name, size_px)
    if is_ros(tree) or is_euroc(tree):
        raise CalibrationFileError(f"{name}: one eye only; give the other eye's file as well, the left one first")
    raise CalibrationFileError(f"{name}: no calibration of a stereo rig; give {KNOWN}")


def _of_two(trees: Sequence[Tree], names: tuple[str, str], size_px: tuple[int, int]) -> RigCalibration:
    left, right = trees
    if is_ros(left) and is_ros(right):
        return parse_ros(left, right, names)
    if is_euroc(left) and is_euroc(right):
        return parse_euroc(left, right, names)
    merged = {**left, **right}
    if is_opencv(merged):
        return parse_opencv(merged, " and ".join(names), size_px)
    raise CalibrationFileError(f"{names[0]} and {names[1]}: no calibration of a stereo rig together; give {KNOWN}")
