"""A camera's mount for other programs: TF, easy_handeye2, a URDF joint, our machine file."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from machine.rotations import Array, quat_wxyz_from_rotation
from machine.urdf_shapes import origin
from recording.files import write_durably


@dataclass(frozen=True, slots=True)
class Mount:
    """The camera in its parent: the hand's frame (`in_hand`) or the base's.

    `covariance`: (6, 6), rotation vector [rad] left of it, then translation [m].
    """

    T_parent_cam: Array
    covariance: Array
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


def _parts(mount: Mount) -> tuple[list[float], list[float]]:
    """Translation and quaternion (w, x, y, z)."""
    T = mount.T_parent_cam
    return T[:3, 3].tolist(), quat_wxyz_from_rotation(T[:3, :3]).tolist()


def as_tf(mount: Mount) -> str:
    """geometry_msgs/TransformStamped as YAML, the command that publishes it, and the covariance as comments."""
    (x, y, z), (w, i, j, k) = _parts(mount)
    transform = {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": mount.parent_frame},
        "child_frame_id": mount.camera_frame,
        "transform": {"translation": {"x": x, "y": y, "z": z}, "rotation": {"x": i, "y": j, "z": k, "w": w}},
    }
    command = (
        f"ros2 run tf2_ros static_transform_publisher --x {x!r} --y {y!r} --z {z!r} --qx {i!r} --qy {j!r} --qz {k!r} "
        f"--qw {w!r} --frame-id {mount.parent_frame} --child-frame-id {mount.camera_frame}"
    )
    rows = [", ".join(f"{value:.6g}" for value in row) for row in mount.covariance]
    notes = [command, "covariance of rotation vector [rad], translation [m]:", *rows]
    return "".join(f"# {note}\n" for note in notes) + yaml.safe_dump({"transforms": [transform]}, sort_keys=False)


def as_easy_handeye2(mount: Mount) -> str:
    """The file that easy_handeye2 keeps and publishes."""
    (x, y, z), (w, i, j, k) = _parts(mount)
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
        f"  {origin(mount.T_parent_cam)}\n</joint>\n"
    )


def as_machine_section(mount: Mount) -> str:
    """The line of [camera] in a machine file whose tcp is the hand's frame."""
    rows = ",\n  ".join(", ".join(repr(value) for value in row) for row in mount.T_parent_cam.tolist())
    return f"# the line of [camera]; the tcp is {json.dumps(mount.hand_frame)}\nT_tcp_cam_left = [\n  {rows},\n]\n"


def sigmas(mount: Mount) -> tuple[Array, Array]:
    """Standard deviations of the rotation (3,) [deg] and the translation (3,) [mm]."""
    all_of = np.sqrt(np.maximum(np.diag(mount.covariance), 0.0))
    return np.rad2deg(all_of[:3]), 1e3 * all_of[3:6]
