"""Foxglove's well-known messages, so that Foxglove and Rerun open a recording without any plug-in."""

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp

from machine.description import StereoCamera
from machine.rotations import Array

LEFT_CAMERA_FRAME_ID = "cam_left"
STRING_SCHEMA_NAME = "std_msgs/String"  # viewers know a robot's description by it; no protobuf name holds a slash
STRING_SCHEMA = b'{"type": "object", "properties": {"data": {"type": "string"}}}'
LOG_LEVEL_NUMBERS = {"debug": 1, "info": 2, "warning": 3, "error": 4}


@dataclass(frozen=True, slots=True)
class FramePose:
    """T_parent_child as one edge of the transform tree; `quat_wxyz` (4,), `position_m` (3,)."""

    parent_frame: str
    child_frame: str
    position_m: tuple[float, float, float]
    quat_wxyz: tuple[float, float, float, float]


def _timestamp_from_utc_ns(t_utc_ns: int) -> Timestamp:
    return Timestamp(seconds=t_utc_ns // 1_000_000_000, nanos=t_utc_ns % 1_000_000_000)


def image_message(jpeg: bytes, t_utc_ns: int) -> Message:
    """The left image."""
    return CompressedImage(
        timestamp=_timestamp_from_utc_ns(t_utc_ns), frame_id=LEFT_CAMERA_FRAME_ID, data=jpeg, format="jpeg"
    )


def log_message(level: str, text: str, t_utc_ns: int) -> Message:
    """One line of the log."""
    return Log(
        timestamp=_timestamp_from_utc_ns(t_utc_ns),
        level=LOG_LEVEL_NUMBERS.get(level, 0),  # pyright: ignore[reportArgumentType]
        message=text,
        name="longreach",
    )


def transforms_message(poses: Sequence[FramePose], t_utc_ns: int) -> Message:
    """Edges of the one transform tree base -> links -> tcp -> cam_left."""
    message = FrameTransforms()
    for pose in poses:
        edge = message.transforms.add(parent_frame_id=pose.parent_frame, child_frame_id=pose.child_frame)
        edge.timestamp.CopyFrom(_timestamp_from_utc_ns(t_utc_ns))
        edge.translation.x, edge.translation.y, edge.translation.z = pose.position_m
        edge.rotation.w, edge.rotation.x, edge.rotation.y, edge.rotation.z = pose.quat_wxyz
    return message


def joint_states_message(names: Sequence[str], q_rad: Sequence[float], t_utc_ns: int) -> Message:
    """Encoder angles by the URDF's joint names [rad]."""
    message = JointStates(timestamp=_timestamp_from_utc_ns(t_utc_ns))
    for name, position in zip(names, q_rad, strict=True):
        message.joints.add(name=name, position=position)
    return message


def description_json(urdf: str) -> str:
    """The robot's description, as JSON of `STRING_SCHEMA`."""
    return json.dumps({"data": urdf})


def calibration_message(camera: StereoCamera, t_utc_ns: int, width_px: int) -> Message:
    """The left eye's intrinsics, scaled to images of this width."""
    scale = width_px / camera.width_px
    K: Array = camera.matrix.copy()
    K[:2, 2] += 0.5  # pixel centres: (u + 0.5) scales, u alone does not
    K[:2] *= scale
    K[:2, 2] -= 0.5
    return CameraCalibration(
        timestamp=_timestamp_from_utc_ns(t_utc_ns),
        frame_id=LEFT_CAMERA_FRAME_ID,
        width=width_px,
        height=round(camera.height_px * scale),
        distortion_model="plumb_bob",
        D=list(camera.distortion),
        K=K.ravel().tolist(),
        R=np.eye(3).ravel().tolist(),
        P=np.hstack([K, np.zeros((3, 1))]).ravel().tolist(),
    )
