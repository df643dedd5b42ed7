"""The numbers of a bag by topic, as they come: joints, points, and a count of everything else."""

from array import array
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from machine.rotations import Array
from recording.errors import RecordingError
from recording.foreign.mapping import Mapping
from recording.foreign.ros_bag import CONTROLLER_STATE_TYPE, NotDecodedError, RosBag, RosMessage

BAG_NUMBERS_MAX = 400_000_000  # of 8 bytes: some 3 GB, hours of an arm at 1 kHz
CLOCK_OFFSET_WARN_S = 5.0
UNREADABLE_MESSAGES_MAX = 20  # of a topic of which no message was read: the rest is not tried
TRACKER_WORDS = ("mocap", "vicon", "optitrack", "qualisys", "vrpn", "tracker", "leica", "rigid_body", "rigidbody")
JOINT_STATE_TYPE = "sensor_msgs/msg/JointState"
DYNAMIC_JOINT_STATE_TYPE = "control_msgs/msg/DynamicJointState"
JOINT_TRAJECTORY_TYPE = "trajectory_msgs/msg/JointTrajectory"
FLOAT_ARRAY_TYPE = "std_msgs/msg/Float64MultiArray"
TF = "tf2_msgs/msg/TFMessage"


@dataclass(slots=True)
class Series:
    """Rows of equal width of one topic. `t_header_s`: 0 without a header; `row_values`: row by row."""

    column_names: tuple[str, ...]
    n_columns: int
    t_recorded_s: array = field(default_factory=lambda: array("d"))
    t_header_s: array = field(default_factory=lambda: array("d"))
    row_values: array = field(default_factory=lambda: array("d"))

    def add(self, t_s: float, stamp_s: float, values: Sequence[float]) -> None:
        """One row."""
        self.t_recorded_s.append(t_s)
        self.t_header_s.append(stamp_s)
        self.row_values.extend(float(value) for value in values)

    @property
    def values(self) -> Array:
        """(m, n_columns)."""
        return np.frombuffer(self.row_values, dtype=float).reshape(-1, self.n_columns).copy()


@dataclass(frozen=True, slots=True)
class Trajectory:
    """One trajectory command: `t_s` recorded at, `stamp_s`, joints, `since_s` its start (m,), positions and velocities
    (m, n); no velocities: None.
    """

    t_s: float
    stamp_s: float
    joint_names: tuple[str, ...]
    since_s: Array
    positions: Array
    velocities: Array | None


@dataclass(slots=True)
class CollectedTopics:
    """By topic: its type, how many messages, how many were not read and why; series by (topic, field, names)."""

    topic_types: dict[str, str] = field(default_factory=dict)
    message_counts: Counter[str] = field(default_factory=Counter)
    failure_reasons: dict[str, str] = field(default_factory=dict)
    failed_message_counts: Counter[str] = field(default_factory=Counter)
    series_by_topic: dict[tuple[str, str, tuple[str, ...]], Series] = field(default_factory=dict)
    trajectories_by_topic: dict[str, list[Trajectory]] = field(default_factory=dict)
    tf_frame_counts: Counter[tuple[str, str]] = field(default_factory=Counter)
    n_numbers: int = 0
    first_s: float = 0.0

    def add(self, topic: str, name: str, names: tuple[str, ...], at: tuple[float, float], values: Any) -> None:
        """One row of one field; fields that are empty, or not one number a joint, are left out."""
        if len(values) == 0 or (names and len(values) != len(names)):
            return
        key = (topic, name, names)
        if key not in self.series_by_topic or self.series_by_topic[key].n_columns != len(values):
            if key in self.series_by_topic:
                return
            self.series_by_topic[key] = Series(names, len(values))
        self.series_by_topic[key].add(*at, values)
        self.n_numbers += len(values) + 2
        if self.n_numbers > BAG_NUMBERS_MAX:
            raise RecordingError(
                f"the bag holds more than {BAG_NUMBERS_MAX:g} numbers of joints and points, the limit; read a part of "
                "it by [window] from_s and to_s of the mapping file"
            )


def collect_signals(bag: RosBag, mapping: Mapping) -> CollectedTopics:
    """All that may be of use, in one pass.

    Raises: RecordingError: the bag cannot be read, is empty, or holds more than memory should take.
    """
    found, first_ns = CollectedTopics(), None
    wanted = {entry.topic for entry in mapping.ros.tracker if entry.topic}
    frames = {entry.frame for entry in mapping.ros.tracker if entry.frame}
    from_s, to_s = mapping.window.from_s, mapping.window.to_s
    for message in bag:
        found.topic_types.setdefault(message.topic, message.message_type)
        first_ns = message.t_ns if first_ns is None else first_ns
        since_s = (message.t_ns - first_ns) * 1e-9
        if (from_s > 0.0 and since_s < from_s) or (to_s is not None and since_s > to_s):
            continue
        found.message_counts[message.topic] += 1
        take = _TAKERS.get(message.message_type)
        if (
            take is None
            or found.failed_message_counts[message.topic]
            == found.message_counts[message.topic] - 1
            >= UNREADABLE_MESSAGES_MAX
        ):
            continue
        try:
            take(found, message, since_s, first_ns, (wanted, frames))
        except NotDecodedError as error:
            found.failure_reasons[message.topic] = str(error)
            found.failed_message_counts[message.topic] += 1
        except (AttributeError, TypeError, ValueError) as error:
            found.failure_reasons[message.topic] = f"its fields are not those of {message.message_type}: {error}"
            found.failed_message_counts[message.topic] += 1
    if first_ns is None:
        raise RecordingError(f"the bag holds no message that can be read{_bag_notes_suffix(bag)}; record it again")
    found.first_s = first_ns * 1e-9
    return found


def _bag_notes_suffix(bag: RosBag) -> str:
    return f" ({'; '.join(bag.notes)})" if bag.notes else ""


def _stamp_s(message: Any, first_ns: int) -> float:
    """The header's stamp since the bag's first message [s]; NaN where none was written."""
    stamp = message.header.stamp
    ns = int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
    return (ns - first_ns) * 1e-9 if ns else float("nan")


def _joint_state(found: CollectedTopics, message: RosMessage, t_s: float, first_ns: int, _: object) -> None:
    fields = message.decode()
    names, at = tuple(fields.name), (t_s, _stamp_s(fields, first_ns))
    for name in ("position", "velocity", "effort"):
        found.add(message.topic, name, names, at, getattr(fields, name))


def _dynamic_state(found: CollectedTopics, message: RosMessage, t_s: float, first_ns: int, _: object) -> None:
    fields = message.decode()
    at = (t_s, _stamp_s(fields, first_ns))
    values: dict[str, list[tuple[str, float]]] = {}
    for joint, interface in zip(fields.joint_names, fields.interface_values, strict=False):
        for name, value in zip(interface.interface_names, interface.values, strict=False):
            values.setdefault(name, []).append((joint, float(value)))
    for name in ("position", "velocity", "effort"):
        if name in values:
            joints, numbers = zip(*values[name], strict=True)
            found.add(message.topic, name, tuple(joints), at, numbers)


def _controller_state(found: CollectedTopics, message: RosMessage, t_s: float, first_ns: int, _: object) -> None:
    fields = message.decode()
    names, at = tuple(fields.joint_names), (t_s, _stamp_s(fields, first_ns))
    for now, before in (("reference", "desired"), ("feedback", "actual"), ("output", "")):
        point = getattr(fields, now, None)
        if (point is None or not len(point.positions)) and before:
            point = getattr(fields, before, point)
        if point is None:
            continue
        for name in ("positions", "velocities", "effort"):
            found.add(message.topic, f"{now}.{name}", names, at, getattr(point, name))


def _collect_trajectory(found: CollectedTopics, message: RosMessage, t_s: float, first_ns: int, _: object) -> None:
    fields = message.decode()
    points, names = fields.points, tuple(fields.joint_names)
    if not points or any(len(point.positions) != len(names) for point in points):
        return
    since = np.array([point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec for point in points])
    known = all(len(point.velocities) == len(names) for point in points)
    velocities = np.array([point.velocities for point in points], dtype=float) if known else None
    positions = np.array([point.positions for point in points], dtype=float)
    one = Trajectory(t_s, _stamp_s(fields, first_ns), names, since, positions, velocities)
    found.trajectories_by_topic.setdefault(message.topic, []).append(one)


def _collect_array(found: CollectedTopics, message: RosMessage, t_s: float, *_: object) -> None:
    found.add(message.topic, "data", (), (t_s, float("nan")), message.decode().data)


def _point_collector(of: Callable[[Any], Any]) -> Callable[..., None]:
    """A taker of messages that hold one point; `of` gives the part with x, y, z."""

    def take(
        found: CollectedTopics, message: RosMessage, t_s: float, first_ns: int, wanted: tuple[set[str], set[str]]
    ) -> None:
        if message.topic in wanted[0] or is_tracker(message.topic):
            fields = message.decode()
            place = of(fields)
            at = (t_s, _stamp_s(fields, first_ns))
            found.add(message.topic, "xyz", (), at, (place.x, place.y, place.z))

    return take


def _collect_transforms(
    found: CollectedTopics, message: RosMessage, t_s: float, first_ns: int, wanted: tuple[set[str], set[str]]
) -> None:
    for transform in message.decode().transforms:
        frame = transform.child_frame_id.lstrip("/")
        found.tf_frame_counts[message.topic, frame] += 1
        if frame in wanted[1] or is_tracker(f"{transform.header.frame_id} {frame}"):
            place = transform.transform.translation
            found.add(
                message.topic, f"frame {frame}", (), (t_s, _stamp_s(transform, first_ns)), (place.x, place.y, place.z)
            )


def is_tracker(name: str) -> bool:
    """Whether a topic or frame is named after a tracker."""
    return any(word in name.lower() for word in TRACKER_WORDS)


_TAKERS: dict[str, Callable[..., None]] = {
    JOINT_STATE_TYPE: _joint_state,
    DYNAMIC_JOINT_STATE_TYPE: _dynamic_state,
    CONTROLLER_STATE_TYPE: _controller_state,
    JOINT_TRAJECTORY_TYPE: _collect_trajectory,
    FLOAT_ARRAY_TYPE: _collect_array,
    "geometry_msgs/msg/PoseStamped": _point_collector(lambda fields: fields.pose.position),
    "geometry_msgs/msg/PointStamped": _point_collector(lambda fields: fields.point),
    "geometry_msgs/msg/TransformStamped": _point_collector(lambda fields: fields.transform.translation),
    TF: _collect_transforms,
    "tf/msg/tfMessage": _collect_transforms,
}


def clock_of(found: CollectedTopics) -> tuple[bool, str]:
    """Whether headers' stamps are the time, and what to say of it: not where they are far from the recorder's clock."""
    apart = [
        np.nanmedian(np.frombuffer(series.t_recorded_s) - np.frombuffer(series.t_header_s))
        for series in found.series_by_topic.values()
        if np.isfinite(np.frombuffer(series.t_header_s)).any()
    ]
    if not apart:
        return False, "no header has a stamp: times are those of recording, later than measured by the transport"
    worst = max(apart, key=abs)
    if abs(worst) > CLOCK_OFFSET_WARN_S:
        return False, f"headers' stamps are {worst:.3g} s from the recorder's clock: times are those of recording"
    return (
        True,
        f"times are the headers' stamps, {1e3 * worst:.2g} ms before recording; commands have none and keep theirs",
    )


def row_times(series: Series, by_stamp: bool) -> Array:
    """When each row counts (m,) [s]: by its stamp where there is one."""
    t, stamp = np.array(series.t_recorded_s), np.array(series.t_header_s)
    return np.where(np.isfinite(stamp), stamp, t) if by_stamp else t


def series_of(found: CollectedTopics, topic: str, name: str) -> Iterator[Series]:
    """The series of one field of a topic; several where its messages name different joints."""
    for (of_topic, of_name, _), series in found.series_by_topic.items():
        if (of_topic, of_name) == (topic, name):
            yield series
