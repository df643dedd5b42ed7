"""Poses for a hand-eye calibration from tables: t or name, x, y, z, qx, qy, qz, qw, or 16 numbers row by row."""

import csv
import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from machine.poses import pose
from machine.rotations import Array, quat_wxyz_from_rotation, rotation_from_quat_wxyz, rotation_from_rotvec, skew
from machine.urdf_shapes import origin_element
from recording.files import read_text, write_durably
from server.camera.rectification_formats import parse_eye
from server.camera.rectification_rig import EyeCalibration, check_eye
from server.camera.rectification_yaml import parse_yaml
from server.camera.target_pictures import IMAGE_FILE_SUFFIXES, charuco_corners, grey_picture
from server.errors import ServerError

ORTHONORMALITY_ERROR_MAX = 1e-2


class HandEyeError(ServerError):
    """Poses or options that a hand-eye calibration cannot use."""


@dataclass(frozen=True, slots=True)
class PoseTable:
    """Rows of a table: labels as written, times (n,) [s] or None where labels are not times, poses (n, 4, 4) [m]."""

    labels: tuple[str, ...]
    t_s: Array | None
    poses: Array


def read_poses(path: Path) -> PoseTable:
    """The poses of a CSV file; a first row of names is passed over.

    Raises: HandEyeError: not readable, or a row that is not a pose; names file and line.
    """
    try:
        lines = read_text(path).splitlines()
    except OSError as error:
        raise HandEyeError(f"{path} cannot be read: {error.strerror}") from error
    labels, Ts = [], []
    for number, row in enumerate(csv.reader(line.replace(";", ",").replace("\t", ",") for line in lines), start=1):
        cells = [cell.strip() for cell in row if cell.strip()]
        if not cells or cells[0].startswith("#"):
            continue
        values = _parse_numbers(cells[1:])
        if values is None and not labels:
            continue
        if values is None or len(values) not in (7, 16):
            raise HandEyeError(
                f"{path}, line {number}: {len(cells)} cells; give a time or name, x, y, z [m], qx, qy, qz, qw, or 16 "
                "numbers of the pose row by row"
            )
        labels.append(cells[0])
        Ts.append(_pose_from_numbers(values, f"{path}, line {number}"))
    if not labels:
        raise HandEyeError(f"{path} holds no poses; give rows of a time or name, x, y, z [m], qx, qy, qz, qw")
    times = _parse_numbers(labels)
    return PoseTable(tuple(labels), None if times is None else np.array(times), np.array(Ts))


def _parse_numbers(cells: list[str]) -> list[float] | None:
    try:
        return [float(cell) for cell in cells]
    except ValueError:
        return None


def _pose_from_numbers(values: list[float], where: str) -> Array:
    if len(values) == 16:
        T = np.array(values).reshape(4, 4)
        if np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max() > ORTHONORMALITY_ERROR_MAX or np.abs(T[3, :3]).max() > 0.0:
            raise HandEyeError(f"{where}: no pose; write it row by row, a rotation and metres, the last row 0, 0, 0, 1")
        return T
    x, y, z, qx, qy, qz, qw = values
    length = float(np.sqrt(qx**2 + qy**2 + qz**2 + qw**2))
    if abs(length - 1.0) > ORTHONORMALITY_ERROR_MAX:
        raise HandEyeError(f"{where}: the quaternion's length is {length:.4f}, not 1; the order is qx, qy, qz, qw")
    T = np.eye(4)
    T[:3, :3] = rotation_from_quat_wxyz(np.array([qw, qx, qy, qz]) / length)
    T[:3, 3] = x, y, z
    return T


def matching_label_rows(hand: PoseTable, camera: PoseTable) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Rows of equal labels in both tables, in the camera's order; None where they are streams with clocks of their own.

    A hand's label may be a picture's file name.
    """
    place = {label if label in camera.labels else Path(label).stem: k for k, label in enumerate(hand.labels)}
    both = [(place[label], k) for k, label in enumerate(camera.labels) if label in place]
    if not place or len(both) < max(3, len(camera.labels) // 2) or len(place) < len(hand.labels):
        return None
    rows = np.array(both)
    return rows[:, 0], rows[:, 1]


# Poses of a ChArUco board in single pictures, with covariance, for a hand-eye calibration.

CORNERS_MIN = 8
CORNER_SIGMA_MIN_PX = 0.1  # of a corner coordinate


@dataclass(frozen=True, slots=True)
class PicturePoses:
    """The board in the camera, by picture; covariances (n, 6, 6): rotation vector left of it [rad], translation [m];
    pictures without a pose, and why.
    """

    pose_table: PoseTable
    pose_covariances: Array
    skipped_pictures: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class Lens:
    """Camera matrix (3, 3) [px] and distortion of one eye; `size_px`: of its pictures, where the file holds it."""

    file: str
    eye_calibration: EyeCalibration
    size_px: tuple[int, int] | None

    def check_picture_size(self, picture: Path, size_px: tuple[int, int]) -> None:
        """Raises: HandEyeError, CalibrationFileError: it is not the lens of a picture of this size."""
        if self.size_px is not None and size_px != self.size_px:
            raise HandEyeError(
                f"{picture} has {size_px[0]} x {size_px[1]} px, but lens {self.file} is of {self.size_px[0]} x "
                f"{self.size_px[1]} px; give the calibration of this picture size"
            )
        check_eye(self.eye_calibration, size_px, f"lens {self.file}")


def read_lens(path: Path) -> Lens:
    """The lens of one eye: a ROS camera_info or an OpenCV file.

    Raises: HandEyeError, CalibrationFileError: not readable, a field is missing, or it is of no plain whole picture.
    """
    try:
        fields = parse_yaml(read_text(path), path.name)
    except OSError as error:
        raise HandEyeError(f"lens {path} cannot be read: {error.strerror}") from error
    eye, size_px = parse_eye(fields)
    if eye.lens_model != "brown":
        raise HandEyeError(f"lens {path} is of the {eye.lens_model} model; calibrate with the pinhole model")
    return Lens(path.name, eye, size_px)


def poses_of_pictures(folder: Path, board: "cv2.aruco.CharucoBoard", lens: Lens) -> PicturePoses:
    """The board's pose in every picture of a folder, named by the file without its ending.

    Raises: HandEyeError: no picture, none shows the board, or one has not the lens file's size.
    """
    files = (
        sorted(path for path in folder.iterdir() if path.suffix.lower() in IMAGE_FILE_SUFFIXES)
        if folder.is_dir()
        else []
    )
    if not files:
        raise HandEyeError(f"{folder} holds no pictures; give a folder of PNG or JPEG")
    detector = cv2.aruco.CharucoDetector(board)
    points = np.asarray(board.getChessboardCorners(), dtype=float)
    labels, Ts, covariances, skipped = list[str](), list[Array](), list[Array](), list[tuple[str, str]]()
    for file in files:
        picture = grey_picture(file)
        lens.check_picture_size(file, (picture.shape[1], picture.shape[0]))
        seen = charuco_corners(detector, points, picture)
        if seen is None or len(seen[0]) < CORNERS_MIN:
            count = 0 if seen is None else len(seen[0])
            skipped.append((file.stem, f"{count} corners of the board, {CORNERS_MIN} are needed"))
            continue
        T, covariance = _pose_of(*seen, lens.eye_calibration.matrix, lens.eye_calibration.coefficients)
        labels.append(file.stem)
        Ts.append(T)
        covariances.append(covariance)
    if not labels:
        raise HandEyeError(f"no picture of {folder} shows the board; check squares, sizes and dictionary")
    return PicturePoses(PoseTable(tuple(labels), None, np.array(Ts)), np.array(covariances), tuple(skipped))


def _pose_of(points: Array, px: Array, K: Array, distortion: Array) -> tuple[Array, Array]:
    """T_cam_board (4, 4), and its covariance s^2 (J^T J)^-1 with s from the residuals, at least
    `CORNER_SIGMA_MIN_PX`."""
    _, r, t = cv2.solvePnP(points, px, K, distortion, flags=cv2.SOLVEPNP_IPPE)
    r, t = cv2.solvePnPRefineLM(points, px, K, distortion, r, t)
    T = pose(rotation_from_rotvec(np.asarray(r, float).ravel()), np.asarray(t, float).ravel())
    seen = np.asarray(cv2.projectPoints(points, r, t, K, distortion)[0], float).reshape(-1, 2)
    variance = max(float(np.sum((seen - px) ** 2)) / (px.size - 6), CORNER_SIGMA_MIN_PX**2)
    J = np.zeros((px.size, 6))
    for k, turned in enumerate(points @ T[:3, :3].T):
        x, y, z = turned + T[:3, 3]
        to_px = np.array([[K[0, 0] / z, 0.0, -K[0, 0] * x / z**2], [0.0, K[1, 1] / z, -K[1, 1] * y / z**2]])
        J[2 * k : 2 * k + 2] = to_px @ np.hstack([-skew(turned), np.eye(3)])
    return T, np.asarray(variance * np.linalg.inv(J.T @ J), dtype=float)


# A camera's mount for other programs: TF, easy_handeye2, a URDF joint, our machine file.


@dataclass(frozen=True, slots=True)
class Mount:
    """The camera in its parent: the hand's frame (`in_hand`) or the base's.

    `covariance`: (6, 6), rotation vector [rad] left of it, then translation [m].
    """

    T_parent_cam: Array
    pose_covariance: Array
    in_hand: bool
    base_frame: str
    hand_frame: str
    camera_frame: str
    target_frame: str

    @property
    def parent_frame(self) -> str:
        """The frame that the camera is fixed to."""
        return self.hand_frame if self.in_hand else self.base_frame


def write_mount(mount: Mount, folder: Path) -> list[Path]:
    """Write all forms. Raises: OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    texts = {
        "tf.yaml": as_tf(mount),
        "easy_handeye2.calib": as_easy_handeye2(mount),
        "joint.urdf": as_urdf_joint(mount),
    }
    if mount.in_hand:
        texts["machine.toml"] = as_machine_section(mount)
    for name, text in texts.items():
        write_durably(folder / name, text)
    return [folder / name for name in texts]


def _translation_and_quaternion(mount: Mount) -> tuple[list[float], list[float]]:
    """Translation and quaternion (w, x, y, z)."""
    T = mount.T_parent_cam
    return T[:3, 3].tolist(), quat_wxyz_from_rotation(T[:3, :3]).tolist()


def as_tf(mount: Mount) -> str:
    """geometry_msgs/TransformStamped as YAML, the command that publishes it, and the covariance as comments."""
    (x, y, z), (w, i, j, k) = _translation_and_quaternion(mount)
    transform = {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": mount.parent_frame},
        "child_frame_id": mount.camera_frame,
        "transform": {"translation": {"x": x, "y": y, "z": z}, "rotation": {"x": i, "y": j, "z": k, "w": w}},
    }
    command = (
        f"ros2 run tf2_ros static_transform_publisher --x {x!r} --y {y!r} --z {z!r} --qx {i!r} --qy {j!r} --qz {k!r} "
        f"--qw {w!r} --frame-id {mount.parent_frame} --child-frame-id {mount.camera_frame}"
    )
    rows = [", ".join(f"{value:.6g}" for value in row) for row in mount.pose_covariance]
    notes = [command, "covariance of rotation vector [rad], translation [m]:", *rows]
    return "".join(f"# {note}\n" for note in notes) + yaml.safe_dump({"transforms": [transform]}, sort_keys=False)


def as_easy_handeye2(mount: Mount) -> str:
    """The file that easy_handeye2 keeps and publishes."""
    (x, y, z), (w, i, j, k) = _translation_and_quaternion(mount)
    body = {
        "parameters": {
            "name": "longreach",
            "calibration_type": "eye_in_hand" if mount.in_hand else "eye_on_base",
            "robot_base_frame": mount.base_frame,
            "robot_effector_frame": mount.hand_frame,
            "tracking_base_frame": mount.camera_frame,
            "tracking_marker_frame": mount.target_frame,
            "freehand_robot_movement": True,
            "move_group_namespace": "/",
            "move_group": "manipulator",
        },
        "transform": {"translation": {"x": x, "y": y, "z": z}, "rotation": {"x": i, "y": j, "z": k, "w": w}},
    }
    return yaml.safe_dump(body, sort_keys=False)


def as_urdf_joint(mount: Mount) -> str:
    """A fixed joint and the camera's link, to be put into a robot's URDF."""
    return (
        f'<link name="{mount.camera_frame}"/>\n<joint name="{mount.camera_frame}_mount" type="fixed">\n'
        f'  <parent link="{mount.parent_frame}"/>\n  <child link="{mount.camera_frame}"/>\n'
        f"  {origin_element(mount.T_parent_cam)}\n</joint>\n"
    )


def as_machine_section(mount: Mount) -> str:
    """The line of [camera] in a machine file whose tcp is the hand's frame."""
    rows = ",\n  ".join(", ".join(repr(value) for value in row) for row in mount.T_parent_cam.tolist())
    return f"# the line of [camera]; the tcp is {json.dumps(mount.hand_frame)}\nT_tcp_cam_left = [\n  {rows},\n]\n"


def mount_sigmas(mount: Mount) -> tuple[Array, Array]:
    """Standard deviations of the rotation (3,) [deg] and the translation (3,) [mm]."""
    all_of = np.sqrt(np.maximum(np.diag(mount.pose_covariance), 0.0))
    return np.rad2deg(all_of[:3]), 1e3 * all_of[3:6]
