"""Poses of a ChArUco board in single pictures, with covariance, for a hand-eye calibration."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from longreach.board_pictures import corners_of, grey_picture
from longreach.hand_eye_poses import HandEyeError, PoseTable
from longreach.target_sources import SUFFIXES
from machine.poses import pose
from machine.rotations import Array, rotation_from_rotvec, skew
from recording.files import read_text
from server.camera.rectification_yaml import parse_yaml

CORNERS_MIN = 8
SIGMA_MIN_PX = 0.1  # of a corner coordinate


@dataclass(frozen=True, slots=True)
class PicturePoses:
    """The board in the camera, by picture; covariances (n, 6, 6): rotation vector left of it [rad], translation [m];
    pictures without a pose, and why.
    """

    table: PoseTable
    covariances: Array
    skipped: tuple[tuple[str, str], ...]


def read_lens(path: Path) -> tuple[Array, Array]:
    """Camera matrix (3, 3) [px] and distortion of one eye: a ROS camera_info or an OpenCV file.

    Raises: HandEyeError, CalibrationFileError: not readable, or a field is missing.
    """
    try:
        fields = parse_yaml(read_text(path), path.name)
    except OSError as error:
        raise HandEyeError(f"lens {path} cannot be read: {error.strerror}") from error
    return fields.matrix("camera_matrix", (3, 3)), fields.numbers("distortion_coefficients")


def poses_of_pictures(folder: Path, board: "cv2.aruco.CharucoBoard", lens: tuple[Array, Array]) -> PicturePoses:
    """The board's pose in every picture of a folder, named by the file without its ending.

    Raises: HandEyeError: no picture, or none shows the board.
    """
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES) if folder.is_dir() else []
    if not files:
        raise HandEyeError(f"{folder} holds no pictures; give a folder of PNG or JPEG")
    detector = cv2.aruco.CharucoDetector(board)
    points = np.asarray(board.getChessboardCorners(), dtype=float)
    labels, Ts, covariances, skipped = list[str](), list[Array](), list[Array](), list[tuple[str, str]]()
    for file in files:
        seen = corners_of(detector, points, grey_picture(file))
        if seen is None or len(seen[0]) < CORNERS_MIN:
            count = 0 if seen is None else len(seen[0])
            skipped.append((file.stem, f"{count} corners of the board, {CORNERS_MIN} are needed"))
            continue
        T, covariance = _pose_of(*seen, *lens)
        labels.append(file.stem)
        Ts.append(T)
        covariances.append(covariance)
    if not labels:
        raise HandEyeError(f"no picture of {folder} shows the board; check squares, sizes and dictionary")
    return PicturePoses(PoseTable(tuple(labels), None, np.array(Ts)), np.array(covariances), tuple(skipped))


def _pose_of(points: Array, px: Array, K: Array, distortion: Array) -> tuple[Array, Array]:
    """T_cam_board (4, 4), and its covariance s^2 (J^T J)^-1 with s from the residuals, at least `SIGMA_MIN_PX`."""
    _, r, t = cv2.solvePnP(points, px, K, distortion, flags=cv2.SOLVEPNP_IPPE)
    r, t = cv2.solvePnPRefineLM(points, px, K, distortion, r, t)
    T = pose(rotation_from_rotvec(np.asarray(r, float).ravel()), np.asarray(t, float).ravel())
    seen = np.asarray(cv2.projectPoints(points, r, t, K, distortion)[0], float).reshape(-1, 2)
    variance = max(float(np.sum((seen - px) ** 2)) / (px.size - 6), SIGMA_MIN_PX**2)
    J = np.zeros((px.size, 6))
    for k, turned in enumerate(points @ T[:3, :3].T):
        x, y, z = turned + T[:3, 3]
        to_px = np.array([[K[0, 0] / z, 0.0, -K[0, 0] * x / z**2], [0.0, K[1, 1] / z, -K[1, 1] * y / z**2]])
        J[2 * k : 2 * k + 2] = to_px @ np.hstack([-skew(turned), np.eye(3)])
    return T, np.asarray(variance * np.linalg.inv(J.T @ J), dtype=float)
