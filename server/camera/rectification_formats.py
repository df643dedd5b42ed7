"""Stereo calibrations in YAML: OpenCV's FileStorage, ROS camera_info, EuRoC's sensor.yaml, Kalibr's camchain. Pure.

Every reader raises CalibrationFileError with file, field and remedy.
"""

import re

import cv2
import numpy as np

from machine.poses import inverse_pose
from machine.rotations import Array
from server.camera.rectification_rig import (
    FISHEYE_COEFFICIENT_COUNT,
    EyeCalibration,
    LensModel,
    RigCalibration,
    checked_rig,
    eye_from_matrix,
    translation_in_metres,
)
from server.camera.rectification_yaml import Fields

# Names under which OpenCV's samples and common tools write them; the first one that is there counts.
CAMERA_MATRIX_KEYS = (
    ("M1", "K1", "cameraMatrix1", "camera_matrix_left", "left_camera_matrix", "K_left", "cameraMatrixL"),
    ("M2", "K2", "cameraMatrix2", "camera_matrix_right", "right_camera_matrix", "K_right", "cameraMatrixR"),
)
DISTORTION_KEYS = (
    ("D1", "distCoeffs1", "dist_coeffs_left", "left_distortion", "D_left", "distCoeffsL"),
    ("D2", "distCoeffs2", "dist_coeffs_right", "right_distortion", "D_right", "distCoeffsR"),
)
ROS_DISTORTION_KEYS = ("distortion_coefficients",)
OPENCV_MODELS: dict[str, LensModel] = {
    **dict.fromkeys(("fisheye", "equidistant", "kannala_brandt"), "fisheye"),
    **dict.fromkeys(
        ("pinhole", "brown", "perspective", "plumb_bob", "radtan", "radial-tangential", "rational_polynomial"), "brown"
    ),
}
MIRROR_PARAMETER_PATTERN = re.compile(r"xi(_?[0-9lr].*)?$", re.IGNORECASE)  # the mirror's parameter of each eye
ROTATION_KEYS = ("R", "rotation", "R_right_left")
TRANSLATION_KEYS = ("T", "translation", "t", "T_right_left")
IMAGE_SIZE_KEYS = ("imageSize", "image_size", "size", "resolution")
IMAGE_WIDTH_HEIGHT_KEYS = (("image_width", "width", "width_px"), ("image_height", "height", "height_px"))


def is_opencv(fields: Fields) -> bool:
    """Whether both eyes' matrices are in one file."""
    return all(fields.of_any(names) for names in CAMERA_MATRIX_KEYS)


def parse_opencv(fields: Fields, size_px: tuple[int, int]) -> RigCalibration:
    """The rig of K1 D1 K2 D2 R T (or M1 ...); without R and T, of R1 P1 R2 P2.

    Model:   OpenCV's stereoCalibrate: p_right = R p_left + T. T in metres or millimetres
             (`translation_in_metres`). A field `model` that says fisheye or equidistant, or `fisheye: 1`,
             makes the lenses fisheye.
    Args:    fields: one file, or intrinsics and extrinsics merged. size_px: used where the file holds no size.
    Source:  OpenCV samples/cpp/stereo_calib.cpp (M1 D1 M2 D2 R T R1 R2 P1 P2 Q), OpenCV 5 calib module.
    """
    model = _read_lens_model(fields)
    left, right = (_opencv_eye(fields, index, model) for index in (0, 1))
    R, t = _stereo_extrinsics(fields)
    width, height = _image_size_px(fields, size_px)
    return checked_rig(RigCalibration(left, right, R, t, width, height), fields.file)


def rig_of_rectification(R1: Array, P1: Array, R2: Array, P2: Array, fields: Fields) -> tuple[Array, Array]:
    """R and t [m] between the eyes from what rectifies them: the rectified frames differ by a shift along x only.

    Model:   p_rect = R1 p_left; p_rect - b = R2 p_right with b = (P1[0, 3] - P2[0, 3]) / f along x.
    """
    focal = float(P1[0, 0])
    if focal <= 0.0 or abs(P2[0, 0] - focal) > 1e-6 * focal:
        raise fields.refusal(f"P1 and P2 have focal lengths {P1[0, 0]:g} and {P2[0, 0]:g}; they must agree")
    shift = np.array([(P2[0, 3] - P1[0, 3]) / focal, 0.0, 0.0])
    return R2.T @ R1, R2.T @ shift


def _required_field_name(fields: Fields, names: tuple[str, ...]) -> str:
    name = fields.of_any(names)
    if name is None:
        raise fields.refusal(f"field {names[0]} (or {', '.join(names[1:4])}) is missing")
    return name


def parse_eye(fields: Fields) -> tuple[EyeCalibration, tuple[int, int] | None]:
    """One eye, and the picture's size [px] where the file holds it: a camera_info, or what OpenCV's samples write.

    Raises: CalibrationFileError: as for a rig.
    """
    if "distortion_model" in fields:
        _refuse_omnidirectional(fields)
        eye = _ros_eye(fields)
    else:
        _refuse_part_of_picture(fields)
        matrix, lens = fields.matrix("camera_matrix", (3, 3)), fields.numbers(ROS_DISTORTION_KEYS[0])
        eye = eye_from_matrix(
            matrix, lens, _read_lens_model(fields, (ROS_DISTORTION_KEYS,)), fields.file, "camera_matrix"
        )
    size = _image_size_px(fields, (0, 0))
    return eye, size if all(size) else None


def _refuse_omnidirectional(fields: Fields) -> None:
    mirror = next((key for key in fields.tree if MIRROR_PARAMETER_PATTERN.match(str(key))), None)
    if mirror is not None:
        raise fields.refusal(
            f"field {mirror} belongs to OpenCV's omnidirectional model (omnidir), which is not read; calibrate with "
            "the pinhole or the fisheye model"
        )


def _read_lens_model(fields: Fields, lens_names: tuple[tuple[str, ...], ...] = DISTORTION_KEYS) -> LensModel:
    """The lens model that a file states; one with four coefficients must state it, because both models have four."""
    _refuse_omnidirectional(fields)
    key = fields.of_any(("model", "camera_model", "distortion_model"))
    if key is not None:
        name = fields.lower_text(key)
        if name not in OPENCV_MODELS:
            raise fields.refusal(f"{key} {name!r} is not read; known are {', '.join(sorted(OPENCV_MODELS))}")
        return OPENCV_MODELS[name]
    flag = fields.of_any(("fisheye", "fisheye_model"))
    if flag is not None:
        return "fisheye" if fields.lower_text(flag) in ("1", "true") else "brown"
    lenses = [fields.numbers(name) for names in lens_names if (name := fields.of_any(names)) is not None]
    if any(len(lens) == FISHEYE_COEFFICIENT_COUNT and lens.any() for lens in lenses):
        raise fields.refusal(
            f"{FISHEYE_COEFFICIENT_COUNT} distortion coefficients are k1 k2 p1 p2 of the pinhole model or k1 k2 k3 k4 "
            "of the fisheye model, and the file does not state which; add the line `model: pinhole` or `model: fisheye`"
        )
    return "brown"


def _opencv_eye(fields: Fields, index: int, model: LensModel) -> EyeCalibration:
    name = _required_field_name(fields, CAMERA_MATRIX_KEYS[index])
    lens = fields.numbers(_required_field_name(fields, DISTORTION_KEYS[index]))
    return eye_from_matrix(fields.matrix(name, (3, 3)), lens, model, fields.file, name)


def _stereo_extrinsics(fields: Fields) -> tuple[Array, Array]:
    rotation, place = fields.of_any(ROTATION_KEYS), fields.of_any(TRANSLATION_KEYS)
    if rotation is not None and place is not None:
        t = fields.matrix(place, (3, 1)).ravel()
        return _read_rotation_matrix(fields, rotation), translation_in_metres(t, fields.file, place)
    if all(name in fields for name in ("R1", "P1", "R2", "P2")):
        R1, R2 = (fields.matrix(name, (3, 3)) for name in ("R1", "R2"))
        P1, P2 = (fields.matrix(name, (3, 4)) for name in ("P1", "P2"))
        R, t = rig_of_rectification(R1, P1, R2, P2, fields)
        return R, translation_in_metres(t, fields.file, "P2")
    raise fields.refusal("R and T (or R1, P1, R2, P2) are missing; give the extrinsics file as well")


def _read_rotation_matrix(fields: Fields, name: str) -> Array:
    values = fields.numbers(name)
    if len(values) == 3:  # a rotation vector
        return np.asarray(cv2.Rodrigues(values)[0], dtype=float)
    return fields.matrix(name, (3, 3))


def _image_size_px(fields: Fields, size_px: tuple[int, int]) -> tuple[int, int]:
    name = fields.of_any(IMAGE_SIZE_KEYS)
    if name is not None:
        width, height = fields.matrix(name, (1, 2)).ravel()
        return int(width), int(height)
    width_name, height_name = (fields.of_any(names) for names in IMAGE_WIDTH_HEIGHT_KEYS)
    if width_name is not None and height_name is not None:
        return fields.whole_number(width_name), fields.whole_number(height_name)
    return size_px


ROS_MODELS: dict[str, tuple[LensModel, tuple[int, ...]]] = {
    "plumb_bob": ("brown", (4, 5)),
    "rational_polynomial": ("brown", (8, 12, 14)),
    "thin_prism": ("brown", (12, 14)),
    "equidistant": ("fisheye", (4,)),
    "fisheye": ("fisheye", (4,)),
}


def is_ros(fields: Fields) -> bool:
    """Whether this looks like one camera_info file."""
    return "camera_matrix" in fields and "projection_matrix" in fields


def parse_ros(left: Fields, right: Fields) -> RigCalibration:
    """The rig of two camera_info files.

    Model:   rectification and projection matrices of both eyes give the place of the right eye; P[0, 3] = -f b [px m].
    Source:  ROS sensor_msgs/CameraInfo; camera_calibration_parsers' YAML; REP 104 for the models.
    """
    files = (left, right)
    eyes = [_ros_eye(file) for file in files]
    sizes = [(file.whole_number("image_width"), file.whole_number("image_height")) for file in files]
    if sizes[0] != sizes[1]:
        raise right.refusal(f"image size {sizes[1]} differs from {left.file}'s {sizes[0]}")
    R1, R2 = (file.matrix("rectification_matrix", (3, 3)) for file in files)
    P1, P2 = (file.matrix("projection_matrix", (3, 4)) for file in files)
    if P2[0, 3] >= P1[0, 3]:
        raise right.refusal(
            f"projection_matrix[0][3] = {P2[0, 3]:g} must be below the left eye's {P1[0, 3]:g}; give the left eye's "
            "file first, and files of one stereo calibration"
        )
    R, t = rig_of_rectification(R1, P1, R2, P2, right)
    rig = RigCalibration(eyes[0], eyes[1], R, translation_in_metres(t, right.file, "projection_matrix"), *sizes[0])
    return checked_rig(rig, f"{left.file} and {right.file}")


def _ros_eye(fields: Fields) -> EyeCalibration:
    _refuse_part_of_picture(fields)
    lens = fields.numbers("distortion_coefficients")
    name = fields.lower_text("distortion_model")
    if name in ("", "none") and not lens.any():
        name, lens = "plumb_bob", lens[:0]
    elif name not in ROS_MODELS or len(lens) not in ROS_MODELS[name][1]:
        known = ", ".join(f"{key} {counts}" for key, (_, counts) in ROS_MODELS.items())
        raise fields.refusal(f"distortion_model {name!r} with {len(lens)} coefficients; known are {known}")
    matrix = fields.matrix("camera_matrix", (3, 3))
    return eye_from_matrix(matrix, lens, ROS_MODELS[name][0], fields.file, "camera_matrix")


def _refuse_part_of_picture(fields: Fields) -> None:
    """Refuse binning and a region of interest: the matrices are of the whole sensor, the pictures then are not.

    Source:  ROS sensor_msgs/CameraInfo: binning 0 is 1, a region of zeros is the whole picture.
    """
    for key in ("binning_x", "binning_y"):
        if key in fields and (binning := float(fields.numbers(key)[0])) > 1.0:
            raise fields.refusal(
                f"{key} = {binning:g}, but the matrices are of the picture without binning; switch the camera's "
                "binning off, or calibrate with it and write 1"
            )
    if "roi" not in fields:
        return
    roi = fields.nested_fields("roi")
    whole_side = {"width": "image_width", "height": "image_height"}
    for key in ("x_offset", "y_offset", "width", "height"):
        value = float(roi.numbers(key)[0]) if key in roi else 0.0
        if value != 0.0 and not (key in whole_side and value == fields.whole_number(whole_side[key])):
            raise fields.refusal(
                f"roi {key} = {value:g}, but the matrices are of the whole picture; switch the camera's region of "
                "interest off, or calibrate with it and write zeros"
            )


KALIBR_MODELS: dict[str, LensModel] = {
    "radial-tangential": "brown",
    "radtan": "brown",
    "none": "brown",
    "equidistant": "fisheye",
}


def is_euroc(fields: Fields) -> bool:
    """Whether this looks like a sensor.yaml."""
    return "T_BS" in fields and "intrinsics" in fields


def is_kalibr(fields: Fields) -> bool:
    """Whether this looks like a camchain.yaml."""
    return "cam0" in fields and "cam1" in fields


def parse_euroc(left: Fields, right: Fields) -> RigCalibration:
    """The rig of cam0/sensor.yaml and cam1/sensor.yaml.

    Model:   T_BS takes sensor to body: T_right_left = inv(T_BS_right) T_BS_left.
    Source:  Burri et al. 2016, The EuRoC micro aerial vehicle datasets, section 3 and its sensor.yaml files.
    """
    T_body_left, T_body_right = _checked_pose_matrix(left, "T_BS"), _checked_pose_matrix(right, "T_BS")
    return _rig_from_kalibr(left, right, inverse_pose(T_body_right) @ T_body_left, "distortion_coefficients")


def parse_kalibr(fields: Fields) -> RigCalibration:
    """The rig of cam0 and cam1 of a camchain.

    Model:   cam1's T_cn_cnm1 takes cam0 to cam1.
    Source:  ethz-asl/kalibr, wiki "yaml formats".
    """
    left, right = fields.nested_fields("cam0"), fields.nested_fields("cam1")
    return _rig_from_kalibr(left, right, _checked_pose_matrix(right, "T_cn_cnm1"), "distortion_coeffs")


def _rig_from_kalibr(left: Fields, right: Fields, T_right_left: Array, lens: str) -> RigCalibration:
    eyes = [_kalibr_eye(eye, lens) for eye in (left, right)]
    sizes = [eye.matrix("resolution", (1, 2)).ravel() for eye in (left, right)]
    if (sizes[0] != sizes[1]).any():
        raise right.refusal(f"resolution {sizes[1]} differs from {left.file}'s {sizes[0]}")
    size = (int(sizes[0][0]), int(sizes[0][1]))
    rig = RigCalibration(eyes[0], eyes[1], T_right_left[:3, :3], T_right_left[:3, 3], *size)
    return checked_rig(rig, f"{left.file} and {right.file}")


def _checked_pose_matrix(fields: Fields, key: str) -> Array:
    T = fields.matrix(key, (4, 4))
    if np.abs(T[3] - [0.0, 0.0, 0.0, 1.0]).max() > 1e-6 or np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max() > 1e-3:
        raise fields.refusal(f"{key} is not a pose; give a 4 x 4 matrix with last row 0 0 0 1")
    return T


def _kalibr_eye(fields: Fields, lens: str) -> EyeCalibration:
    if "camera_model" in fields and fields.lower_text("camera_model") != "pinhole":
        raise fields.refusal(f"camera_model {fields.lower_text('camera_model')!r}; only pinhole is known")
    name = fields.lower_text("distortion_model")
    if name not in KALIBR_MODELS:
        raise fields.refusal(f"distortion_model {name!r}; known are {', '.join(KALIBR_MODELS)}")
    fx, fy, cx, cy = fields.matrix("intrinsics", (1, 4)).ravel()
    coefficients = fields.numbers(lens) if name != "none" else np.zeros(0)
    values = tuple(float(value) for value in coefficients)
    return EyeCalibration(float(fx), float(fy), float(cx), float(cy), values, KALIBR_MODELS[name])
