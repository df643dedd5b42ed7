"""Calibrations of EuRoC data sets (two sensor.yaml) and of Kalibr (one camchain.yaml): trees -> rig. Pure."""

import numpy as np

from machine.poses import inverse_pose
from machine.rotations import Array
from server.camera.rectification_rig import CalibrationFileError, EyeCalibration, LensModel, RigCalibration, checked_rig
from server.camera.rectification_yaml import Tree, mapping, matrix, numbers, text_of

MODELS: dict[str, LensModel] = {
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
    eyes = [_eye(tree, file, lens) for tree, file in zip((left, right), files, strict=True)]
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


def _eye(tree: Tree, file: str, lens: str) -> EyeCalibration:
    if "camera_model" in tree and text_of(tree, "camera_model", file) != "pinhole":
        raise CalibrationFileError(
            f"{file}: camera_model {text_of(tree, 'camera_model', file)!r}; only pinhole is known"
        )
    name = text_of(tree, "distortion_model", file)
    if name not in MODELS:
        raise CalibrationFileError(f"{file}: distortion_model {name!r}; known are {', '.join(MODELS)}")
    fx, fy, cx, cy = matrix(tree, "intrinsics", file, (1, 4)).ravel()
    coefficients = numbers(tree, lens, file) if name != "none" else np.zeros(0)
    values = tuple(float(value) for value in coefficients)
    return EyeCalibration(float(fx), float(fy), float(cx), float(cy), values, MODELS[name])
