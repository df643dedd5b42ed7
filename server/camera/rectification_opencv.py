"""Stereo calibrations as OpenCV's FileStorage writes them (YAML): trees -> rig. Pure."""

import re

import cv2
import numpy as np

from machine.rotations import Array
from server.camera.rectification_rig import (
    FISHEYE_COUNT,
    CalibrationFileError,
    EyeCalibration,
    LensModel,
    RigCalibration,
    checked_rig,
    eye_from_matrix,
    metres,
)
from server.camera.rectification_yaml import Tree, matrix, numbers, text_of, whole

# Names under which OpenCV's samples and common tools write them; the first one that is there counts.
MATRIX_NAMES = (
    ("M1", "K1", "cameraMatrix1", "camera_matrix_left", "left_camera_matrix", "K_left", "cameraMatrixL"),
    ("M2", "K2", "cameraMatrix2", "camera_matrix_right", "right_camera_matrix", "K_right", "cameraMatrixR"),
)
LENS_NAMES = (
    ("D1", "distCoeffs1", "dist_coeffs_left", "left_distortion", "D_left", "distCoeffsL"),
    ("D2", "distCoeffs2", "dist_coeffs_right", "right_distortion", "D_right", "distCoeffsR"),
)
MODELS: dict[str, LensModel] = {
    **dict.fromkeys(("fisheye", "equidistant", "kannala_brandt"), "fisheye"),
    **dict.fromkeys(
        ("pinhole", "brown", "perspective", "plumb_bob", "radtan", "radial-tangential", "rational_polynomial"), "brown"
    ),
}
OMNIDIRECTIONAL = re.compile(r"xi(_?[0-9lr].*)?$", re.IGNORECASE)  # the mirror's parameter of each eye
ROTATION_NAMES = ("R", "rotation", "R_right_left")
PLACE_NAMES = ("T", "translation", "t", "T_right_left")
SIZE_NAMES = ("imageSize", "image_size", "size", "resolution")
SIDE_NAMES = (("image_width", "width", "width_px"), ("image_height", "height", "height_px"))


def is_opencv(tree: Tree) -> bool:
    """Whether both eyes' matrices are in one tree."""
    return all(any(name in tree for name in names) for names in MATRIX_NAMES)


def parse_opencv(tree: Tree, file: str, size_px: tuple[int, int]) -> RigCalibration:
    """The rig of K1 D1 K2 D2 R T (or M1 ...); without R and T, of R1 P1 R2 P2.

    Model:   OpenCV's stereoCalibrate: p_right = R p_left + T. T in metres or millimetres (`metres`). A field `model`
             that says fisheye or equidistant, or `fisheye: 1`, makes the lenses fisheye.
    Args:    tree: one file, or intrinsics and extrinsics merged. size_px: used where the file holds no size.
    Raises:  CalibrationFileError: file, field, remedy.
    Source:  OpenCV samples/cpp/stereo_calib.cpp (M1 D1 M2 D2 R T R1 R2 P1 P2 Q), OpenCV 5 calib module.
    """
    model = _model(tree, file)
    left, right = (_eye(tree, index, model, file) for index in (0, 1))
    R, t = _places(tree, file)
    width, height = _size(tree, file, size_px)
    return checked_rig(RigCalibration(left, right, R, t, width, height), file)


def rig_of_rectification(R1: Array, P1: Array, R2: Array, P2: Array, file: str) -> tuple[Array, Array]:
    """R and t [m] between the eyes from what rectifies them: the rectified frames differ by a shift along x only.

    Model:   p_rect = R1 p_left; p_rect - b = R2 p_right with b = (P1[0, 3] - P2[0, 3]) / f along x.
    Raises:  CalibrationFileError: the projections are not of one rectified pair.
    """
    focal = float(P1[0, 0])
    if focal <= 0.0 or abs(P2[0, 0] - focal) > 1e-6 * focal:
        raise CalibrationFileError(
            f"{file}: P1 and P2 have focal lengths {P1[0, 0]:g} and {P2[0, 0]:g}; they must agree"
        )
    shift = np.array([(P2[0, 3] - P1[0, 3]) / focal, 0.0, 0.0])
    return R2.T @ R1, R2.T @ shift


def _found(tree: Tree, names: tuple[str, ...]) -> str | None:
    return next((name for name in names if name in tree), None)


def _needed(tree: Tree, names: tuple[str, ...], file: str) -> str:
    name = _found(tree, names)
    if name is None:
        raise CalibrationFileError(f"{file}: field {names[0]} (or {', '.join(names[1:4])}) is missing")
    return name


def _model(tree: Tree, file: str) -> LensModel:
    """The lens model that a file states; one with four coefficients must state it, because both models have four.

    Raises: CalibrationFileError: a model that is not read, or none where the numbers do not show which.
    """
    mirror = next((key for key in tree if OMNIDIRECTIONAL.match(str(key))), None)
    if mirror is not None:
        raise CalibrationFileError(
            f"{file}: field {mirror} belongs to OpenCV's omnidirectional model (omnidir), which is not read; calibrate "
            "with the pinhole or the fisheye model"
        )
    for key in ("model", "camera_model", "distortion_model"):
        if key in tree:
            name = text_of(tree, key, file)
            if name not in MODELS:
                raise CalibrationFileError(f"{file}: {key} {name!r} is not read; known are {', '.join(sorted(MODELS))}")
            return MODELS[name]
    if "fisheye" in tree:
        return "fisheye" if text_of(tree, "fisheye", file) in ("1", "true") else "brown"
    lenses = [numbers(tree, name, file) for names in LENS_NAMES if (name := _found(tree, names)) is not None]
    if any(len(lens) == FISHEYE_COUNT and lens.any() for lens in lenses):
        raise CalibrationFileError(
            f"{file}: {FISHEYE_COUNT} distortion coefficients are k1 k2 p1 p2 of the pinhole model or k1 k2 k3 k4 of "
            "the fisheye model, and the file does not state which; add the line `model: pinhole` or `model: fisheye`"
        )
    return "brown"


def _eye(tree: Tree, index: int, model: LensModel, file: str) -> EyeCalibration:
    name = _needed(tree, MATRIX_NAMES[index], file)
    lens = numbers(tree, _needed(tree, LENS_NAMES[index], file), file)
    return eye_from_matrix(matrix(tree, name, file, (3, 3)), lens, model, file, name)


def _places(tree: Tree, file: str) -> tuple[Array, Array]:
    rotation, place = _found(tree, ROTATION_NAMES), _found(tree, PLACE_NAMES)
    if rotation is not None and place is not None:
        t = matrix(tree, place, file, (3, 1)).ravel()
        return _rotation(tree, rotation, file), metres(t, file, place)
    if all(name in tree for name in ("R1", "P1", "R2", "P2")):
        R1, R2 = (matrix(tree, name, file, (3, 3)) for name in ("R1", "R2"))
        P1, P2 = (matrix(tree, name, file, (3, 4)) for name in ("P1", "P2"))
        R, t = rig_of_rectification(R1, P1, R2, P2, file)
        return R, metres(t, file, "P2")
    raise CalibrationFileError(f"{file}: R and T (or R1, P1, R2, P2) are missing; give the extrinsics file as well")


def _rotation(tree: Tree, name: str, file: str) -> Array:
    values = numbers(tree, name, file)
    if len(values) == 3:  # a rotation vector
        return np.asarray(cv2.Rodrigues(values)[0], dtype=float)
    return matrix(tree, name, file, (3, 3))


def _size(tree: Tree, file: str, size_px: tuple[int, int]) -> tuple[int, int]:
    name = _found(tree, SIZE_NAMES)
    if name is not None:
        width, height = matrix(tree, name, file, (1, 2)).ravel()
        return int(width), int(height)
    sides = [_found(tree, names) for names in SIDE_NAMES]
    if sides[0] is not None and sides[1] is not None:
        return whole(tree, sides[0], file), whole(tree, sides[1], file)
    return size_px
