"""Poses for a hand-eye calibration from a ROS bag: the hand by joint states and URDF, the target by a pose topic."""

from pathlib import Path

import numpy as np

from longreach.hand_eye_poses import HandEyeError, PoseTable
from machine.effects.arm_urdf import arm_from_urdf
from machine.effects.layout import neutral_sets
from machine.effects.structure import tcp_poses
from machine.errors import MachineError
from machine.rotations import rotation_from_quat_wxyz
from recording.errors import RecordingError
from recording.files import read_text
from recording.foreign.mapping import UrdfChain
from recording.foreign.ros_bag import NotDecodedError, RosBag
from recording.foreign.ros_collect import JOINT_STATE
from recording.foreign.urdf_ends import chain_for

POSES_MAX = 1_000_000


def poses_of_bag(bag: Path, topic: str, urdf: Path, base_link: str, hand_link: str) -> tuple[PoseTable, PoseTable]:
    """The hand in the base and the target in the camera, each with the times of its headers.

    Args:   topic: geometry_msgs/PoseStamped of the target in the camera. base_link, hand_link: of the URDF; empty: the
            root, and the link that the last recorded joint moves.
    Raises: HandEyeError: no such poses, no joint states, or a URDF of another robot.
    """
    joints: dict[tuple[str, ...], list[tuple[float, list[float]]]] = {}
    seen: list[tuple[float, list[float]]] = []
    topics = set[str]()
    try:
        for message in RosBag(bag):
            topics.add(message.topic)
            if message.topic != topic and message.kind != JOINT_STATE:
                continue
            if len(seen) + sum(map(len, joints.values())) >= POSES_MAX:
                raise HandEyeError(f"{bag} holds more than {POSES_MAX} poses and joint states; cut it")
            fields = message.decode()
            stamp = fields.header.stamp
            t_s = (stamp.sec + 1e-9 * stamp.nanosec) or 1e-9 * message.t_ns
            if message.topic == topic:
                place, turn = fields.pose.position, fields.pose.orientation
                seen.append((t_s, [place.x, place.y, place.z, turn.w, turn.x, turn.y, turn.z]))
            elif len(fields.position) == len(fields.name):
                joints.setdefault(tuple(fields.name), []).append((t_s, list(fields.position)))
        if not seen or not joints:
            missing = f"poses on {topic}" if not seen else "joint states"
            raise HandEyeError(f"{bag} holds no {missing}; its topics are {', '.join(sorted(topics)[:20])}")
        names, rows = max(joints.items(), key=lambda one: len(one[1]))
        text = read_text(urdf)
        chain = chain_for(text, names, UrdfChain(base_link=base_link, tip_link=hand_link))
        moving = [joint.name for joint in chain.joints if joint.name in names]
        arm, _ = arm_from_urdf(text, chain.base_link, chain.tip_link, moving)
    except (RecordingError, MachineError, NotDecodedError, AttributeError) as error:
        raise HandEyeError(f"{bag}: {error}") from error
    except OSError as error:
        raise HandEyeError(f"{urdf} cannot be read: {error.strerror}") from error
    q = np.array([row for _, row in rows])[:, [names.index(name) for name in moving]]
    hand = PoseTable((), np.array([t for t, _ in rows]), tcp_poses(arm, neutral_sets(arm.n), q))
    Ts = np.tile(np.eye(4), (len(seen), 1, 1))
    for k, (_, row) in enumerate(seen):
        Ts[k, :3, 3], quat = row[:3], np.array(row[3:])
        Ts[k, :3, :3] = rotation_from_quat_wxyz(quat / max(float(np.linalg.norm(quat)), 1e-12))
    return hand, PoseTable((), np.array([t for t, _ in seen]), Ts)
