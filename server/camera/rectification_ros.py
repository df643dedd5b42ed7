"""A pair of ROS camera_info files (YAML), left and right: trees -> rig. Pure."""

from server.camera.rectification_opencv import rig_of_rectification
from server.camera.rectification_rig import (
    CalibrationFileError,
    EyeCalibration,
    LensModel,
    RigCalibration,
    checked_rig,
    eye_from_matrix,
    metres,
)
from server.camera.rectification_yaml import Tree, mapping, matrix, numbers, text_of, whole

MODELS: dict[str, tuple[LensModel, tuple[int, ...]]] = {
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
    eyes = [_eye(tree, file) for tree, file in zip((left, right), files, strict=True)]
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


def _eye(tree: Tree, file: str) -> EyeCalibration:
    _refuse_part_of_picture(tree, file)
    lens = numbers(tree, "distortion_coefficients", file)
    name = text_of(tree, "distortion_model", file)
    if name in ("", "none") and not lens.any():
        name, lens = "plumb_bob", lens[:0]
    elif name not in MODELS or len(lens) not in MODELS[name][1]:
        known = ", ".join(f"{key} {counts}" for key, (_, counts) in MODELS.items())
        raise CalibrationFileError(
            f"{file}: distortion_model {name!r} with {len(lens)} coefficients; known are {known}"
        )
    return eye_from_matrix(matrix(tree, "camera_matrix", file, (3, 3)), lens, MODELS[name][0], file, "camera_matrix")


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
