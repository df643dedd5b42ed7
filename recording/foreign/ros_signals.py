"""Assign ROS topics to signals: by the mapping, by type, else by name, which is a guess to confirm."""

import json
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from machine.rotations import Array
from recording.errors import RecordingError
from recording.foreign.found import JointSignal, Kind, SourceContents, SourceEntry, TrackedPointSeries, in_time_order
from recording.foreign.mapping import CommandKind, Mapping
from recording.foreign.ros_bag import CONTROLLER_STATE_TYPE, RosBag
from recording.foreign.ros_collect import (
    DYNAMIC_JOINT_STATE_TYPE,
    FLOAT_ARRAY_TYPE,
    JOINT_STATE_TYPE,
    JOINT_TRAJECTORY_TYPE,
    TF,
    UNREADABLE_MESSAGES_MAX,
    CollectedTopics,
    Series,
    Trajectory,
    clock_of,
    collect_signals,
    row_times,
    series_of,
)

TRAJECTORY_SAMPLE_STEP_S = 0.01  # a trajectory's curve between its points is written at this step
HOLD_END_MARGIN_S = 1e-6
REFERENCE_WORDS = ("command", "cmd", "desired", "target", "reference", "setpoint", "goal", "leader", "master", "action")
KINDS: tuple[CommandKind, ...] = ("velocity", "effort", "position")


def ros_found(path: Path, mapping: Mapping) -> SourceContents:
    """What a bag holds, and what each topic is taken for.

    Raises: RecordingError: no bag, an empty one, a topic of the mapping that is not there, or no encoders.
    """
    bag = RosBag(path)
    collected = collect_signals(bag, mapping)
    return _SignalChooser(collected, mapping).found(bag)


class _SignalChooser:
    def __init__(self, collected: CollectedTopics, mapping: Mapping) -> None:
        self._all = collected
        self._mapping = mapping
        self._out = SourceContents(started_s=collected.first_s)
        self._used: set[str] = set()
        self._by_stamp, clock = clock_of(collected)
        self._out.notes.append(clock)

    def found(self, bag: RosBag) -> SourceContents:
        ros = self._mapping.ros
        for topic in (ros.encoders, ros.reference, ros.command, *(tracker.topic for tracker in ros.tracker)):
            if topic and topic not in self._all.topic_types:
                raise RecordingError(
                    f"the mapping names topic {topic}, which is not in the bag: {self._topic_list_text()}"
                )
        self._select_reference_signals()
        self._select_encoder_signals()
        self._select_command_signals()
        self._select_tracked_points()
        self._list_ignored_topics()
        self._out.proposed_mapping_toml = self._proposed_mapping_text()
        self._out.notes += bag.notes
        self._out.truncated = bag.cut
        if not self._out.signals_of("position") and not self._out.tracked_points:
            raise RecordingError(
                f"no joint positions and no tracked points of the bag could be read: {self._missing_signal_reason()}"
            )
        return self._out

    def _topic_list_text(self) -> str:
        return ", ".join(sorted(self._all.topic_types)[:20]) or "it has no topic"

    def _missing_signal_reason(self) -> str:
        failures = [f"{topic}: {why}" for topic, why in self._all.failure_reasons.items()]
        return "; ".join(failures) or f"its topics are {self._topic_list_text()}; name the topics in a mapping file"

    def _mark_topic_used(self, topic: str, why: str, guess: bool = False) -> None:
        self._used.add(topic)
        kind, count = self._all.topic_types.get(topic, ""), self._all.message_counts[topic]
        if self._all.failed_message_counts[topic]:
            why += f"; {self._all.failed_message_counts[topic]} messages are damaged and left out"
        self._out.entries.append(SourceEntry(topic, kind, count, "used", why, guess))

    def _proposed_mapping_text(self) -> str:
        """What was chosen as a mapping file, to be corrected."""
        roles = {"encoders": "position", "reference": "reference", "command": "command"}
        lines = ["[ros]"]
        for key, kind in roles.items():
            sources = [signal.source.split(" ")[0] for signal in self._out.signals if signal.kind == kind]
            lines += [f"{key} = {json.dumps(sources[0])}"] if sources else []
        lines += [f'command_kind = "{self._out.command_kind}"'] if self._out.command_kind else []
        for track in self._out.tracked_points:
            place = ("frame", track.name) if track.source.startswith("/tf") else ("topic", track.source)
            lines += ["[[ros.tracker]]", f"{place[0]} = {json.dumps(place[1])}", f"point = {json.dumps(track.name)}"]
        return "\n".join(lines) + "\n"

    def _add(self, kind: Kind, topic: str, name: str, held: bool = False) -> bool:
        found = False
        for series in series_of(self._all, topic, name):
            names = series.column_names or tuple(self._mapping.ros.encoder_joints)
            if len(names) != series.n_columns:
                self._all.failure_reasons[topic] = (
                    f"its messages name no joints: give names for its {series.n_columns} numbers as [ros] "
                    "encoder_joints "
                    "of the mapping file"
                )
                continue
            t, values = in_time_order(row_times(series, self._by_stamp), series.values)
            if len(t) > 1:
                self._out.signals.append(JointSignal(kind, f"{topic} {name}", names, t, values, held))
                found = True
        return found

    def _is_topic_unreadable(self, topic: str) -> bool:
        """Whether no message of a topic could be read."""
        return self._all.failed_message_counts[topic] > 0 and self._all.failed_message_counts[topic] >= min(
            self._all.message_counts[topic], UNREADABLE_MESSAGES_MAX
        )

    def _of_type(self, kind: str) -> list[str]:
        """Topics of a type that were read, the one with most messages first."""
        topics = [
            topic for topic, of in self._all.topic_types.items() if of == kind and not self._is_topic_unreadable(topic)
        ]
        return sorted(topics, key=lambda topic: -self._all.message_counts[topic])

    def _select_reference_signals(self) -> None:
        wanted = self._mapping.ros.reference
        states = [wanted] if wanted else self._of_type(CONTROLLER_STATE_TYPE)
        for topic in states:
            if self._all.topic_types[topic] != CONTROLLER_STATE_TYPE:
                break
            if self._add("reference", topic, "reference.positions"):
                self._add("velocity_reference", topic, "reference.velocities")
                self._mark_topic_used(topic, "reference and feedback of the joints, by type")
        if self._out.signals_of("reference"):
            return
        if wanted:
            if not self._reference_from(wanted):
                raise RecordingError(
                    f"topic {wanted} of the mapping holds no joint positions: {self._missing_signal_reason()}"
                )
            self._mark_topic_used(wanted, "reference of the joints, by the mapping")
            return
        for topic in self._of_type(JOINT_STATE_TYPE):
            if _has_any_word(topic, REFERENCE_WORDS) and self._reference_from(topic):
                self._mark_topic_used(topic, "reference of the joints, by its name", guess=True)
                return
        for topic in self._of_type(JOINT_TRAJECTORY_TYPE):
            if self._reference_from(topic):
                self._mark_topic_used(
                    topic, "reference of the joints: its trajectories one after the other", guess=True
                )
                return

    def _reference_from(self, topic: str) -> bool:
        kind = self._all.topic_types[topic]
        if kind == JOINT_TRAJECTORY_TYPE:
            signals = _concatenate_trajectories(topic, self._all.trajectories_by_topic.get(topic, ()), self._by_stamp)
            self._out.signals += signals
            return bool(signals)
        return self._add("reference", topic, "position", held=True)

    def _select_encoder_signals(self) -> None:
        """From the controller's state where it is fast enough, since reference and feedback are of one moment there."""
        wanted = self._mapping.ros.encoders
        used = {signal.source.split(" ")[0] for signal in self._out.signals_of("reference")}
        states = [
            topic
            for topic in self._of_type(JOINT_STATE_TYPE) + self._of_type(DYNAMIC_JOINT_STATE_TYPE)
            if topic not in used
        ]
        if wanted:
            is_state = self._all.topic_types[wanted] == CONTROLLER_STATE_TYPE
            if not self._add("position", wanted, "feedback.positions" if is_state else "position"):
                raise RecordingError(
                    f"topic {wanted} of the mapping holds no joint positions: {self._missing_signal_reason()}"
                )
            self._mark_topic_used(wanted, "encoders, by the mapping")
            return
        most = max((self._all.message_counts[topic] for topic in states), default=0)
        for topic in self._of_type(CONTROLLER_STATE_TYPE):
            if 2 * self._all.message_counts[topic] >= most and self._add("position", topic, "feedback.positions"):
                return
        states = [topic for topic in states if not _has_any_word(topic, REFERENCE_WORDS)] or states
        states.sort(key=lambda topic: (not topic.endswith("joint_states"), -self._all.message_counts[topic]))
        for topic in states:
            if self._add("position", topic, "position"):
                several = (
                    len([state_topic for state_topic in states if not state_topic.endswith("dynamic_joint_states")]) > 1
                )
                self._mark_topic_used(topic, "encoders, by type" + (" and name" if several else ""), guess=several)
                return
        for topic in self._of_type(CONTROLLER_STATE_TYPE):
            self._add("position", topic, "feedback.positions")

    def _select_command_signals(self) -> None:
        ros = self._mapping.ros
        for topic in [] if ros.command else self._of_type(CONTROLLER_STATE_TYPE):
            if self._add("command", topic, "output.velocities", held=True):
                self._out.command_kind = "velocity"
                return
        topics = (
            [ros.command]
            if ros.command
            else [topic for topic in self._of_type(FLOAT_ARRAY_TYPE) if _has_any_word(topic, ("command", "cmd"))]
        )
        for topic in topics:
            kind = ros.command_kind or _kind_by_name(topic)
            names = tuple(ros.command_joints) or self._encoder_joint_names()
            series = next(iter([*series_of(self._all, topic, "data"), *series_of(self._all, topic, "velocity")]), None)
            if series is None or kind is None:
                continue
            names = series.column_names or names
            if len(names) != series.n_columns:
                if ros.command:
                    raise RecordingError(f"topic {topic} has {series.n_columns} numbers; give as many command_joints")
                continue
            self._add_command_topic(topic, kind, names, series)
            return

    def _add_command_topic(self, topic: str, kind: CommandKind, names: tuple[str, ...], series: Series) -> None:
        guess = not (self._mapping.ros.command and self._mapping.ros.command_kind)
        how = f"{kind} commands of {', '.join(names)}" + (", by its name and the encoders' order" if guess else "")
        if kind == "effort":
            self._used.add(topic)
            why = "effort commands: a torque-driven joint has no nominal model here; the reference is used"
            self._out.entries.append(
                SourceEntry(topic, self._all.topic_types[topic], self._all.message_counts[topic], "ignored", why)
            )
            return
        if kind == "position" and self._out.signals_of("reference"):
            return
        t, values = in_time_order(row_times(series, self._by_stamp), series.values)
        what: Kind = "reference" if kind == "position" else "command"
        self._out.signals.append(JointSignal(what, topic, names, t, values, hold_last_value=True))
        self._out.command_kind = "" if kind == "position" else kind
        self._mark_topic_used(topic, how, guess)

    def _encoder_joint_names(self) -> tuple[str, ...]:
        signals = self._out.signals_of("position")
        return max(signals, key=lambda signal: len(signal.t_s)).joint_names if signals else ()

    def _select_tracked_points(self) -> None:
        named = {(tracker.topic, tracker.frame): tracker.point for tracker in self._mapping.ros.tracker}
        for (topic, name, _), series in self._all.series_by_topic.items():
            frame = name.removeprefix("frame ") if name.startswith("frame ") else ""
            if name != "xyz" and not frame:
                continue
            mapped = named.get((topic, frame)) or named.get(("", frame) if frame else (topic, ""))
            if named and mapped is None:
                continue
            t, xyz = in_time_order(row_times(series, self._by_stamp), series.values)
            point = mapped or (frame or topic).strip("/").replace("/", "_")
            self._out.tracked_points.append(TrackedPointSeries(point, topic, t, xyz))
            self._mark_topic_used(
                topic, f"tracked point {point!r}" + ("" if mapped else ", by its name"), guess=mapped is None
            )

    def _list_ignored_topics(self) -> None:
        """Every topic that is not used, and why."""
        frames = sorted({frame for _, frame in self._all.tf_frame_counts})
        shown = ", ".join(frames[:8]) + (" ..." if len(frames) > 8 else "")
        for topic, kind in sorted(self._all.topic_types.items()):
            if topic in self._used:
                continue
            why = self._all.failure_reasons.get(topic) or _why_ignored(kind, shown)
            self._out.entries.append(SourceEntry(topic, kind, self._all.message_counts[topic], "ignored", why))


def _why_ignored(kind: str, frames: str) -> str:
    if kind in (TF, "tf/msg/tfMessage"):
        return f"frames {frames}: name one as [[ros.tracker]] frame to use it"
    if kind.startswith("geometry_msgs/"):
        return "name it as [[ros.tracker]] topic to use it as a tracked point"
    if kind in ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/CameraInfo"):
        return "images are not used; extract them for `longreach hand-eye --images` or `longreach camera calibrate`"
    if kind in (
        JOINT_STATE_TYPE,
        DYNAMIC_JOINT_STATE_TYPE,
        CONTROLLER_STATE_TYPE,
        JOINT_TRAJECTORY_TYPE,
        FLOAT_ARRAY_TYPE,
    ):
        return "another topic is used, or it has no numbers; name it in the mapping file to use it"
    return "not a signal that the diagnosis uses"


def _has_any_word(topic: str, words: Sequence[str]) -> bool:
    return any(word in topic.lower() for word in words)


def _kind_by_name(topic: str) -> CommandKind | None:
    return next((kind for kind in KINDS if kind in topic.lower()), None)


def _concatenate_trajectories(topic: str, trajectories: Sequence[Trajectory], by_stamp: bool) -> list[JointSignal]:
    """Trajectories one after the other; each counts until the next one starts, and its end is held."""
    by_names: dict[tuple[str, ...], list[Trajectory]] = {}
    for trajectory in trajectories:
        by_names.setdefault(trajectory.joint_names, []).append(trajectory)
    signals = []
    for names, several in by_names.items():
        starts = [
            trajectory.stamp_s if by_stamp and np.isfinite(trajectory.stamp_s) else trajectory.t_s
            for trajectory in several
        ]
        ends = [*starts[1:], np.inf]
        times_s, rows = list[Array](), list[Array]()
        for trajectory, start, end in zip(several, starts, ends, strict=True):
            t, positions = _sample_trajectory(trajectory, rows[-1][-1] if rows else None)
            inside = start + t < end - HOLD_END_MARGIN_S
            if not inside.any():
                continue
            times_s.append(start + t[inside])
            rows.append(positions[inside])
        if not rows:
            continue
        held_t, held = [times_s[0]], [rows[0]]
        for (before, after), (last, row) in zip(pairwise(times_s), pairwise(rows), strict=True):
            if after[0] - before[-1] > 2.0 * HOLD_END_MARGIN_S:
                held_t.append(np.array([after[0] - HOLD_END_MARGIN_S]))
                held.append(last[-1:])
            held_t.append(after)
            held.append(row)
        t, values = in_time_order(np.concatenate(held_t), np.concatenate(held))
        signals.append(JointSignal("reference", topic, names, t, values))
    return signals


def _sample_trajectory(one: Trajectory, before: Array | None) -> tuple[Array, Array]:
    """Times since the start and positions: cubic where points have velocities as ros2_control does; else lines."""
    since, positions, velocities = one.since_s, one.positions, one.velocities
    if since[0] > 0.0 and before is not None:
        since, positions = np.r_[0.0, since], np.vstack([before, positions])
        velocities = None if velocities is None else np.vstack([np.zeros(len(before)), velocities])
    if velocities is None or len(since) < 2 or (np.diff(since) <= 0.0).any():
        return since, positions
    fine = np.unique(np.r_[np.arange(since[0], since[-1], TRAJECTORY_SAMPLE_STEP_S), since])
    return fine, CubicHermiteSpline(since, positions, velocities)(fine)
