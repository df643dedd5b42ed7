"""Pose streams from files: CSV (t, x, y, z, qx, qy, qz, qw) in zip archives, and TUM trajectories."""

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from machine.rotations import Array

#: The archive, the hand's and the camera's file in it; the camera's file holds target from camera.
HAND_EYE_FILES = {
    "real": (
        "robot_arm_w_color_camera_real.zip",
        "robot_arm/robot_arm_complete_bag_color_and_ir_base_link_sr300_hinge.csv",
        "robot_arm/robot_arm_complete_bag_color_and_ir_target_ir.csv",
    ),
    "sim": (
        "robot_arm_w_color_camera_sim.zip",
        "robot_arm_w_color_camera_sim/robot_arm_sim_hand.csv",
        "robot_arm_w_color_camera_sim/robot_arm_sim_camera.csv",
    ),
}
#: Estimate, truth.
TRAJECTORY_FILES = {
    "fr2_desk ORB": ("fr2_desk_ORB.txt", "fr2_desk_groundtruth.txt"),
    "fr1_xyz RGB-D SLAM": ("freiburg1_xyz-rgbdslam.txt", "freiburg1_xyz-groundtruth.txt"),
}


@dataclass(frozen=True, slots=True)
class PoseStream:
    """Times (n,) [s], strictly increasing, and poses (n, 4, 4)."""

    t_s: Array
    Ts: Array


def read_hand_eye(folder: Path, name: str) -> tuple[PoseStream, PoseStream]:
    """Hand in base, and target from camera, of "real" or "sim"; times from the hand's first one."""
    archive, hand_file, camera_file = HAND_EYE_FILES[name]
    with zipfile.ZipFile(folder / archive) as pack:
        hand, camera = (np.loadtxt(io.BytesIO(pack.read(file)), delimiter=",") for file in (hand_file, camera_file))
    start = hand[0, 0]
    return _stream(hand, start), _stream(camera, start)


def read_trajectories(folder: Path, name: str) -> tuple[PoseStream, PoseStream]:
    """Estimated and true trajectory of one of `TRAJECTORY_FILES`; times from the truth's first one."""
    estimate, truth = (np.loadtxt(folder / file) for file in TRAJECTORY_FILES[name])
    return _stream(estimate, truth[0, 0]), _stream(truth, truth[0, 0])


def _stream(rows: Array, start_s: float) -> PoseStream:
    """Rows (n, 8); of equal times the first is kept."""
    _, firsts = np.unique(rows[:, 0], return_index=True)
    rows = rows[firsts]
    Ts = np.tile(np.eye(4), (len(rows), 1, 1))
    Ts[:, :3, :3] = Rotation.from_quat(rows[:, 4:8]).as_matrix()
    Ts[:, :3, 3] = rows[:, 1:4]
    return PoseStream(rows[:, 0] - start_s, Ts)
