"""What a plan may ask of the engine: small frozen requests; `reply = yield Request(...)`.

A plan is a plain generator: it decides, the engine acts. So every plan runs in tests without a clock or a socket.
"""

from collections.abc import Generator, Iterable
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np

from recording.run import SegmentKind
from server.calibration.contracts import Array, CameraRotationEstimate
from server.jobs.records import ComparedMove, MoveRecord
from server.motion.contracts import JointTrajectory, PathPlan
from server.motion.identification_courses import SegmentMark
from server.targets.contracts import AnchoredTarget
from server.vision.contracts import ObjectPose, PairObservation, PoseStatus

# Looks on the way: what a plan asks for while the machine moves, and what it gets: pairs that showed both objects.

USABLE_POSE_STATUSES = (PoseStatus.OK, PoseStatus.ORIENTATION_AMBIGUOUS)


@dataclass(frozen=True, slots=True)
class StartWatching:
    """Keep every pair's poses from now on. Reply: None."""

    source: Literal["stereo", "mono"]


@dataclass(frozen=True, slots=True)
class StopWatching:
    """Reply: (SeenPairs, EncoderTrack) since StartWatching."""


@dataclass(frozen=True, slots=True)
class SeenPairs:
    """Pairs that showed both: times (n,) [s, camera clock mapped], OOI minus tool (n, 3) [m], Rs_cam_ooi (n, 3, 3)."""

    t_s: Array
    vectors_cam: Array
    Rs_cam_ooi: Array


def sighted_of(pairs: Iterable[tuple[float, PairObservation]]) -> SeenPairs:
    """From (time [s], pair); pairs without both objects are left out."""
    t, vectors, turns = [], [], []
    for t_s, pair in pairs:
        tool, ooi = pair.tool.T_cam_object, pair.ooi.T_cam_object
        if (
            pair.tool.status in USABLE_POSE_STATUSES
            and pair.ooi.status in USABLE_POSE_STATUSES
            and tool is not None
            and ooi is not None
        ):
            t.append(t_s)
            vectors.append(ooi[:3, 3] - tool[:3, 3])
            turns.append(ooi[:3, :3])
    return SeenPairs(np.array(t), np.array(vectors).reshape(-1, 3), np.array(turns).reshape(-1, 3, 3))


# What a plan may ask for while the machine moves: pairs as they come, corrections, a stop.


@dataclass(frozen=True, slots=True)
class StartMove:
    """Begin a trajectory and do not wait for its end. Reply: None. `Correct`, `EndMove` and `StopMove` belong to it."""

    trajectory: JointTrajectory
    purpose: str


@dataclass(frozen=True, slots=True)
class NextPair:
    """Wait for a pair newer than number `after_number`, at most `silence_max_s` since the last one. Reply: PairSeen.

    `time_offset_s`: add to the camera's time to get the encoders'.
    """

    after_number: int
    silence_max_s: float
    time_offset_s: float


@dataclass(frozen=True, slots=True)
class PairSeen:
    """One pair as it came, with the encoders at its exposure and how the motion stands.

    `fault`: why it must not be acted upon (silent camera, old or unfit picture, no encoders for it); empty when it may.
    `tail_status`: what became of the last `Correct`; taken and refused are reported once.
    """

    number: int
    fault: str
    tool: ObjectPose | None
    ooi: ObjectPose | None
    q_rad: Array | None
    t_play_s: float
    motion_ended: bool
    tail_status: Literal["none", "pending", "taken", "refused"] = "none"
    tail_text: str = ""


@dataclass(frozen=True, slots=True)
class Correct:
    """Replace the running trajectory from knot `first_knot` on. Reply: None immediately; later pairs report the
    result."""

    trajectory: JointTrajectory
    first_knot: int


@dataclass(frozen=True, slots=True)
class EndMove:
    """Wait for the end of what was begun. Reply: None; a stop or refusal fails the job."""


@dataclass(frozen=True, slots=True)
class StopMove:
    """Ramp down now and hold. Reply: None, at rest."""

    reason: str


Steer = StartMove | NextPair | Correct | EndMove | StopMove


@dataclass(frozen=True, slots=True)
class ReadMachine:
    """Reply: MachineReading, averaged over the last 100 ms. Fails the job when the PLC is silent."""


@dataclass(frozen=True, slots=True)
class MachineReading:
    """Joints at rest or in motion, as the PLC last reported them."""

    q_rad: Array
    q_ref_rad: Array
    t_plc_ns: int
    t_mono_ns: int
    oil_temperature_c: float | None = None  # None where the machine does not measure it
    side: Array | None = None  # where each joint rests in its play (n,), -1 to 1; None where it is not followed


@dataclass(frozen=True, slots=True)
class Arm:
    """Arm the PLC unless it is armed already. Reply: None."""


@dataclass(frozen=True, slots=True)
class Move:
    """Play a trajectory of the reference to its end. Reply: None; a stop or refusal fails the job.

    `segment_marks`: stretches that become segments of the recording, as far as they were driven.
    """

    trajectory: JointTrajectory
    purpose: str
    segment_marks: tuple[SegmentMark, ...] = ()


@dataclass(frozen=True, slots=True)
class Settle:
    """Wait until the encoders rest. Reply: MachineReading at rest; fails after the settle timeout."""


@dataclass(frozen=True, slots=True)
class TakeLook:
    """Robust mean over pairs at standstill. Reply: Look (a failed look is a reply, not an error)."""

    n_pairs: int
    source: Literal["stereo", "mono"] = "stereo"


@dataclass(frozen=True, slots=True)
class StartOdometry:
    """Start the camera's own trajectory. Reply: None."""


@dataclass(frozen=True, slots=True)
class TimePairs:
    """Watch some pairs of the odometry that is on. Reply: PairTiming."""

    n_pairs: int = 8


@dataclass(frozen=True, slots=True)
class PairTiming:
    """Time between two pairs with the camera's pose [s]: the longest but one of those watched."""

    interval_s: float


@dataclass(frozen=True, slots=True)
class StopOdometry:
    """Reply: (CameraTrack, EncoderTrack) since StartOdometry, both on the PC clock."""


@dataclass(frozen=True, slots=True)
class UseTarget:
    """Serve this target as the object of interest from the next pair on. Reply: None."""

    target: AnchoredTarget


@dataclass(frozen=True, slots=True)
class Progress:
    """Report to every client how far the job has come. Reply: None."""

    name: str
    current: float
    target: float
    unit: str
    text: str


@dataclass(frozen=True, slots=True)
class Record:
    """Put a finding into the recording and the job's own list. Reply: None."""

    item: MoveRecord | ComparedMove | CameraRotationEstimate | PathPlan
    text: str = ""


@dataclass(frozen=True, slots=True)
class BeginSegment:
    """What happens from here on is a segment of the recording, of that kind. Reply: None."""

    name: str
    kind: SegmentKind


@dataclass(frozen=True, slots=True)
class EndSegment:
    """Close the open segment, if any. Reply: None."""


Request = (
    ReadMachine
    | Arm
    | Move
    | Settle
    | TakeLook
    | StartOdometry
    | TimePairs
    | StopOdometry
    | StartWatching
    | StopWatching
    | Steer
    | UseTarget
    | Progress
    | Record
    | BeginSegment
    | EndSegment
)

#: A plan yields requests, is sent their replies, and returns its result.
Plan = Generator[Request, object, object]


Reply = TypeVar("Reply")


def expect_reply(reply: object, expected: type[Reply]) -> Reply:
    """The engine's reply, which must be of the type that the request promises; anything else is a defect."""
    if not isinstance(reply, expected):
        raise TypeError(f"reply is {type(reply).__name__}, expected {expected.__name__}")
    return reply
