"""Stereo calibrations in YAML: OpenCV's FileStorage, ROS camera_info, EuRoC's sensor.yaml, Kalibr's camchain. Pure."""

import re

import cv2
import numpy as np

from machine.poses import inverse_pose
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
from server.camera.rectification_yaml import Tree, mapping, matrix, numbers, text_of, whole

# Names under which OpenCV's samples and common tools write them; the first one that is there counts.
MATRIX_NAMES = (
    ("M1", "K1", "cameraMatrix1", "camera_matrix_left", "left_camera_matrix", "K_left", "cameraMatrixL"),
    ("M2", "K2", "cameraMatrix2", "camera_matrix_right", "right_camera_matrix", "K_right", "cameraMatrixR"),
)
LENS_NAMES = (
    ("D1", "distCoeffs1", "dist_coeffs_left", "left_distortion", "D_left", "distCoeffsL"),
    ("D2", "distCoeffs2", "dist_coeffs_right", "right_distortion", "D_right", "distCoeffsR"),
)
OPENCV_MODELS: dict[str, LensModel] = {
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
    left, right = (_opencv_eye(tree, index, model, file) for index in (0, 1))
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
            if name not in OPENCV_MODELS:
                raise CalibrationFileError(
                    f"{file}: {key} {name!r} is not read; known are {', '.join(sorted(OPENCV_MODELS))}"
                )
            return OPENCV_MODELS[name]
    if "fisheye" in tree:
        return "fisheye" if text_of(tree, "fisheye", file) in ("1", "true") else "brown"
    lenses = [numbers(tree, name, file) for names in LENS_NAMES if (name := _found(tree, names)) is not None]
    if any(len(lens) == FISHEYE_COUNT and lens.any() for lens in lenses):
        raise CalibrationFileError(
            f"{file}: {FISHEYE_COUNT} distortion coefficients are k1 k2 p1 p2 of the pinhole model or k1 k2 k3 k4 of "
            "the fisheye model, and the file does not state which; add the line `model: pinhole` or `model: fisheye`"
        )
    return "brown"


def _opencv_eye(tree: Tree, index: int, model: LensModel, file: str) -> EyeCalibration:
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


ROS_MODELS: dict[str, tuple[LensModel, tuple[int, ...]]] = {
    "plumb_bob": ("brown", (4, 5)),
    "rational_polynomial": ("brown", (8, 12, 14)),
    "thin_prism": ("brown", (12, 14)),
    "equidistant": ("fisheye", (4,)),
    "fisheye": ("fisheye", (4,)),
}


def is_ros(tree: Tree) -> bool:
    """Whether a tree looks like one camera_info file."""
    return "camera_matrix" in tree and "projection_matrix" in tree


def parse_ros(left: Tree, right: Tree, files: tuple[str, str]) -> RigCalibration:
    """The rig of two camera_info files.

    Model:   rectification and projection matrices of both eyes give the place of the right eye; P[0, 3] = -f b [px m].
    Raises:  CalibrationFileError: file, field, remedy.
    Source:  ROS sensor_msgs/CameraInfo; camera_calibration_parsers' YAML; REP 104 for the models.
    """
    eyes = [_ros_eye(tree, file) for tree, file in zip((left, right), files, strict=True)]
    sizes = [
        (whole(tree, "image_width", file), whole(tree, "image_height", file))
        for tree, file in zip((left, right), files, strict=True)
    ]
    if sizes[0] != sizes[1]:
        raise CalibrationFileError(f"{files[1]}: image size {sizes[1]} differs from {files[0]}'s {sizes[0]}")
    R1, R2 = (
        matrix(tree, "rectification_matrix", file, (3, 3)) for tree, file in zip((left, right), files, strict=True)
    )
    P1, P2 = (matrix(tree, "projection_matrix", file, (3, 4)) for tree, file in zip((left, right), files, strict=True))
    if P2[0, 3] >= P1[0, 3]:
        raise CalibrationFileError(
            f"{files[1]}: projection_matrix[0][3] = {P2[0, 3]:g} must be below the left eye's {P1[0, 3]:g}; give the "
            "left eye's file first, and files of one stereo calibration"
        )
    R, t = rig_of_rectification(R1, P1, R2, P2, files[1])
    rig = RigCalibration(eyes[0], eyes[1], R, metres(t, files[1], "projection_matrix"), *sizes[0])
    return checked_rig(rig, f"{files[0]} and {files[1]}")


def _ros_eye(tree: Tree, file: str) -> EyeCalibration:
    _refuse_part_of_picture(tree, file)
    lens = numbers(tree, "distortion_coefficients", file)
    name = text_of(tree, "distortion_model", file)
    if name in ("", "none") and not lens.any():
        name, lens = "plumb_bob", lens[:0]
    elif name not in ROS_MODELS or len(lens) not in ROS_MODELS[name][1]:
        known = ", ".join(f"{key} {counts}" for key, (_, counts) in ROS_MODELS.items())
        raise CalibrationFileError(
            f"{file}: distortion_model {name!r} with {len(lens)} coefficients; known are {known}"
        )
    return eye_from_matrix(
        matrix(tree, "camera_matrix", file, (3, 3)), lens, ROS_MODELS[name][0], file, "camera_matrix"
    )


def _refuse_part_of_picture(tree: Tree, file: str) -> None:
    """Refuse binning and a region of interest: the matrices are of the whole sensor, the pictures then are not.

    Source:  ROS sensor_msgs/CameraInfo: binning 0 is 1, a region of zeros is the whole picture.
    """
    for key in ("binning_x", "binning_y"):
        if key in tree and float(numbers(tree, key, file)[0]) > 1.0:
            raise CalibrationFileError(
                f"{file}: {key} = {float(numbers(tree, key, file)[0]):g}, but the matrices are of the picture without "
                "binning; switch the camera's binning off, or calibrate with it and write 1"
            )
    if "roi" not in tree:
        return
    roi = mapping(tree, "roi", file)
    whole_side = {"width": "image_width", "height": "image_height"}
    for key in ("x_offset", "y_offset", "width", "height"):
        value = float(numbers(roi, key, f"{file}: roi")[0]) if key in roi else 0.0
        if value != 0.0 and not (key in whole_side and value == whole(tree, whole_side[key], file)):
            raise CalibrationFileError(
                f"{file}: roi {key} = {value:g}, but the matrices are of the whole picture; switch the camera's region "
                "of interest off, or calibrate with it and write zeros"
            )


KALIBR_MODELS: dict[str, LensModel] = {
    "radial-tangential": "brown",
    "radtan": "brown",
    "none": "brown",
    "equidistant": "fisheye",
}


def is_euroc(tree: Tree) -> bool:
    """Whether a tree looks like a sensor.yaml."""
    return "T_BS" in tree and "intrinsics" in tree


def is_kalibr(tree: Tree) -> bool:
    """Whether a tree looks like a camchain.yaml."""
    return "cam0" in tree and "cam1" in tree


def parse_euroc(left: Tree, right: Tree, files: tuple[str, str]) -> RigCalibration:
    """The rig of cam0/sensor.yaml and cam1/sensor.yaml.

    Model:   T_BS takes sensor to body: T_right_left = inv(T_BS_right) T_BS_left.
    Raises:  CalibrationFileError: file, field, remedy.
    Source:  Burri et al. 2016, The EuRoC micro aerial vehicle datasets, section 3 and its sensor.yaml files.
    """
    T_body_left, T_body_right = (_pose(tree, "T_BS", file) for tree, file in zip((left, right), files, strict=True))
    return _rig(left, right, inverse_pose(T_body_right) @ T_body_left, files, "distortion_coefficients")


def parse_kalibr(tree: Tree, file: str) -> RigCalibration:
    """The rig of cam0 and cam1 of a camchain.

    Model:   cam1's T_cn_cnm1 takes cam0 to cam1.
    Raises:  CalibrationFileError: file, field, remedy.
    Source:  ethz-asl/kalibr, wiki "yaml formats".
    """
    left, right = mapping(tree, "cam0", file), mapping(tree, "cam1", file)
    files = (f"{file}: cam0", f"{file}: cam1")
    return _rig(left, right, _pose(right, "T_cn_cnm1", files[1]), files, "distortion_coeffs")


def _rig(left: Tree, right: Tree, T_right_left: Array, files: tuple[str, str], lens: str) -> RigCalibration:
    eyes = [_kalibr_eye(tree, file, lens) for tree, file in zip((left, right), files, strict=True)]
    sizes = [matrix(tree, "resolution", file, (1, 2)).ravel() for tree, file in zip((left, right), files, strict=True)]
    if (sizes[0] != sizes[1]).any():
        raise CalibrationFileError(f"{files[1]}: resolution {sizes[1]} differs from {files[0]}'s {sizes[0]}")
    size = (int(sizes[0][0]), int(sizes[0][1]))
    rig = RigCalibration(eyes[0], eyes[1], T_right_left[:3, :3], T_right_left[:3, 3], *size)
    return checked_rig(rig, " and ".join(files))


def _pose(tree: Tree, key: str, file: str) -> Array:
    T = matrix(tree, key, file, (4, 4))
    if np.abs(T[3] - [0.0, 0.0, 0.0, 1.0]).max() > 1e-6 or np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max() > 1e-3:
        raise CalibrationFileError(f"{file}: {key} is not a pose; give a 4 x 4 matrix with last row 0 0 0 1")
    return T


def _kalibr_eye(tree: Tree, file: str, lens: str) -> EyeCalibration:
    if "camera_model" in tree and text_of(tree, "camera_model", file) != "pinhole":
        raise CalibrationFileError(
            f"{file}: camera_model {text_of(tree, 'camera_model', file)!r}; only pinhole is known"
        )
    name = text_of(tree, "distortion_model", file)
    if name not in KALIBR_MODELS:
        raise CalibrationFileError(f"{file}: distortion_model {name!r}; known are {', '.join(KALIBR_MODELS)}")
    fx, fy, cx, cy = matrix(tree, "intrinsics", file, (1, 4)).ravel()
    coefficients = numbers(tree, lens, file) if name != "none" else np.zeros(0)
    values = tuple(float(value) for value in coefficients)
    return EyeCalibration(float(fx), float(fy), float(cx), float(cy), values, KALIBR_MODELS[name])
