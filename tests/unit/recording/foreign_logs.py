"""Logs of other systems for the tests: a two-joint arm as a rosbag2, and its URDF."""

from pathlib import Path

import numpy as np
import pytest

rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")

from recording.foreign.ros_bag import CONTROLLER_STATE_DEFINITIONS, CONTROLLER_STATE_TYPE  # noqa: E402

T0_NS = 1_700_000_000_000_000_000
STEP_S = 0.01
ARM = """<robot name="arm"><link name="base"/><link name="l1"/><link name="l2"/><link name="f1"/><link name="f2"/>
<joint name="j1" type="revolute"><parent link="base"/><child link="l1"/><origin xyz="0 0 0.2"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" velocity="2.5" effort="10"/></joint>
<joint name="j2" type="revolute"><parent link="l1"/><child link="l2"/><origin xyz="1 0 0"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" velocity="1.5" effort="10"/></joint>
<joint name="finger" type="prismatic"><parent link="l2"/><child link="f1"/><axis xyz="0 1 0"/>
<limit lower="0" upper="0.04" velocity="2.5" effort="10"/></joint>
<joint name="finger2" type="prismatic"><parent link="l2"/><child link="f2"/><axis xyz="0 -1 0"/>
<limit lower="0" upper="0.04" velocity="2.5" effort="10"/><mimic joint="finger"/></joint></robot>"""


def reference(t: float) -> np.ndarray:
    return np.array([0.5 * np.sin(0.7 * t), 0.4 * np.sin(1.1 * t)])


def encoders(t: float) -> np.ndarray:
    return reference(t - 0.03)


class BagMaker:
    """Writes messages of a store's types."""

    def __init__(self, path: Path, plugin: str, distribution: int = 0) -> None:
        self.store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        self.store.register(
            typesys.get_types_from_msg(CONTROLLER_STATE_DEFINITIONS[distribution], CONTROLLER_STATE_TYPE)
        )
        self._writer = rosbag2.Writer(path, version=9, storage_plugin=getattr(rosbag2.StoragePlugin, plugin))
        self._connections: dict[str, object] = {}

    def __enter__(self) -> "BagMaker":
        self._writer.open()
        return self

    def __exit__(self, *_: object) -> None:
        self._writer.close()

    def make(self, kind: str, **fields: object) -> object:
        return self.store.types[kind](**fields)

    def header(self, t: float) -> object:
        ns = T0_NS + round(t * 1e9)
        stamp = self.make("builtin_interfaces/msg/Time", sec=ns // 10**9, nanosec=ns % 10**9)
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id="")

    def point(self, positions: object) -> object:
        empty = np.zeros(0)
        still = self.make("builtin_interfaces/msg/Duration", sec=0, nanosec=0)
        return self.make(
            "trajectory_msgs/msg/JointTrajectoryPoint",
            positions=np.asarray(positions, float),
            velocities=empty,
            accelerations=empty,
            effort=empty,
            time_from_start=still,
        )

    def write(self, topic: str, kind: str, message: object, t: float) -> None:
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, kind, typestore=self.store)
        self._writer.write(self._connections[topic], T0_NS + round(t * 1e9), self.store.serialize_cdr(message, kind))

    def joint_state(self, topic: str, t: float, names: list[str], positions: object) -> None:
        empty = np.zeros(0)
        kind = "sensor_msgs/msg/JointState"
        fields = {"position": np.asarray(positions, float), "velocity": empty, "effort": empty}
        self.write(topic, kind, self.make(kind, header=self.header(t), name=names, **fields), t)

    def controller_state(self, topic: str, t: float, names: list[str]) -> None:
        many = self.make(
            "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint",
            transforms=[],
            velocities=[],
            accelerations=[],
            time_from_start=self.make("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
        )
        kind = self.store.types[CONTROLLER_STATE_TYPE]
        given = {
            "header": self.header(t),
            "joint_names": names,
            "reference": self.point(reference(t)),
            "desired": self.point(reference(t)),
            "feedback": self.point(encoders(t)),
            "actual": self.point(encoders(t)),
            "multi_dof_joint_names": [],
            "speed_scaling_factor": 1.0,
        }
        fields = [name for name in kind.__dataclass_fields__ if not name.startswith("__")]
        rest = {name: many if name.startswith("multi_dof") else self.point([]) for name in fields if name not in given}
        message = kind(**{name: value for name, value in {**rest, **given}.items() if name in fields})
        self.write(topic, CONTROLLER_STATE_TYPE, message, t)

    def array(self, topic: str, t: float, values: object) -> None:
        layout = self.make("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
        kind = "std_msgs/msg/Float64MultiArray"
        self.write(topic, kind, self.make(kind, layout=layout, data=np.asarray(values, float)), t)

    def pose(self, topic: str, t: float, xyz: object, quat_xyzw: object = (0.0, 0.0, 0.0, 1.0)) -> None:
        x, y, z = np.asarray(xyz, float).tolist()
        place = self.make("geometry_msgs/msg/Point", x=x, y=y, z=z)
        i, j, k, w = np.asarray(quat_xyzw, float).tolist()
        turn = self.make("geometry_msgs/msg/Quaternion", x=i, y=j, z=k, w=w)
        pose = self.make("geometry_msgs/msg/Pose", position=place, orientation=turn)
        kind = "geometry_msgs/msg/PoseStamped"
        self.write(topic, kind, self.make(kind, header=self.header(t), pose=pose), t)
