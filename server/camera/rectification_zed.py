"""Factory calibration of Stereolabs' ZED cameras, SNxxxx.conf: text -> rig. Pure."""

import configparser

import cv2
import numpy as np

from server.camera.rectification_rig import CalibrationFileError, EyeCalibration, RigCalibration, checked_rig

SECTION_SUFFIX_BY_SIZE = {  # one eye's size -> ending of the sections
    (2208, 1242): "2K",
    (1920, 1080): "FHD",
    (1920, 1200): "FHD1200",
    (1280, 720): "HD",
    (960, 600): "SVGA",
    (672, 376): "VGA",
}
DISTORTION_COEFFICIENT_KEYS = ("k1", "k2", "p1", "p2", "k3")


def is_zed(text: str) -> bool:
    """Whether a text looks like such a file."""
    return "[left_cam_" in text.lower()


def parse_zed(text: str, file: str, size_px: tuple[int, int]) -> RigCalibration:
    """The rig at one image size.

    Model:   [LEFT_CAM_<R>], [RIGHT_CAM_<R>]: fx fy cx cy [px], k1 k2 k3 p1 p2; [STEREO]: Baseline, TY, TZ [mm] (also
             TY_<R>, TZ_<R>), RX_<R>, CV_<R>, RZ_<R> [rad], <R> the resolution. R = exp([RX CV RZ]) takes points of the
             left eye to the right one, t = -(Baseline, TY, TZ): the whole vector's sign is free in rectification, and
             the right eye lies at +x.
    Args:    text: the file. size_px: one eye's width and height, of which the file must know the calibration.
    Source:  Stereolabs' own reader, stereolabs/zed-open-capture:examples/include/calibration.hpp; fields:
             docs.stereolabs.com, "Camera Calibration". Spelling BaseLine: willdzeng/zed_cpu_ros pull request 3.
    """
    ini = configparser.RawConfigParser(strict=False, allow_no_value=True)
    try:
        ini.read_string(text)
    except configparser.Error as error:
        raise CalibrationFileError(f"{file}: not the ini text of a ZED ({str(error).splitlines()[0]})") from error
    sections = {name.lower(): ini[name] for name in ini.sections()}
    ending = SECTION_SUFFIX_BY_SIZE.get(size_px)
    if ending is None or f"left_cam_{ending.lower()}" not in sections:
        known = [
            f"{w} x {h}" for (w, h), end in SECTION_SUFFIX_BY_SIZE.items() if f"left_cam_{end.lower()}" in sections
        ]
        raise CalibrationFileError(
            f"{file}: no calibration for images of {size_px[0]} x {size_px[1]} px an eye; it has "
            f"{', '.join(known) or 'none'}: set the camera to one of them"
        )
    ini_reader = _CaseInsensitiveFields(file, sections)
    turn = [ini_reader.number("stereo", f"{axis}_{ending}") for axis in ("RX", "CV", "RZ")]
    place_mm = [ini_reader.number("stereo", "baseline"), *(_of_any(ini_reader, axis, ending) for axis in ("TY", "TZ"))]
    R, _ = cv2.Rodrigues(np.array(turn))
    rig = RigCalibration(
        left=_read_eye_calibration(ini_reader, f"left_cam_{ending}"),
        right=_read_eye_calibration(ini_reader, f"right_cam_{ending}"),
        R_right_left=np.asarray(R, dtype=float),
        t_right_left_m=-1e-3 * np.array(place_mm),
        width_px=size_px[0],
        height_px=size_px[1],
    )
    return checked_rig(rig, file)


class _CaseInsensitiveFields:
    """Numbers by section and key, whatever their case."""

    def __init__(self, file: str, sections: dict[str, configparser.SectionProxy]) -> None:
        self._file = file
        self._sections = sections

    def has(self, section: str, key: str) -> bool:
        """Whether the key is there."""
        return section.lower() in self._sections and key.lower() in self._sections[section.lower()]

    def number(self, section: str, key: str) -> float:
        """A finite number."""
        subject = f"{self._file}: [{section.upper()}] {key}"
        if not self.has(section, key):
            raise CalibrationFileError(f"{subject} is missing; load the camera's file from the maker again")
        value = self._sections[section.lower()][key.lower()]
        try:
            number = float(value)
        except (TypeError, ValueError):
            number = float("nan")
        if not np.isfinite(number):
            raise CalibrationFileError(f"{subject} = {value!r} is not a number; load the camera's file again")
        return number


def _of_any(fields: _CaseInsensitiveFields, axis: str, ending: str) -> float:
    """TY or TZ: older files have one of each for every resolution."""
    own = f"{axis}_{ending}"
    return fields.number("stereo", own if fields.has("stereo", own) else axis)


def _read_eye_calibration(fields: _CaseInsensitiveFields, section: str) -> EyeCalibration:
    fx, fy, cx, cy = (fields.number(section, key) for key in ("fx", "fy", "cx", "cy"))
    needed = {"k1", "k2"}
    lens = tuple(
        fields.number(section, key) if key in needed or fields.has(section, key) else 0.0
        for key in DISTORTION_COEFFICIENT_KEYS
    )
    return EyeCalibration(fx, fy, cx, cy, lens)
