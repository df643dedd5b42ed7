"""What a plan may ask of the engine: small frozen requests; `reply = yield Request(...)`.

A plan is a plain generator: it decides, the engine acts. So every plan runs in tests without a clock or a socket.
"""

from collections.abc import Generator
from dataclasses import dataclass
from typing import Literal, TypeVar

from recording.run import SegmentKind
from server.calibration.contracts import Array, CameraRotationEstimate
from server.jobs.records import ComparedMove, MoveRecord
from server.jobs.steer_requests import Steer
from server.jobs.watching import StartWatching, StopWatching
from server.motion.contracts import JointTrajectory, PathPlan
from server.motion.identification_courses import Mark
from server.targets.contracts import AnchoredTarget


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

    `marks`: stretches that become segments of the recording, as far as they were driven.
    """

    trajectory: JointTrajectory
    purpose: str
    marks: tuple[Mark, ...] = ()


@dataclass(frozen=True, slots=True)
class Settle:
    """Wait until the encoders rest. Reply: MachineReading at rest; fails after the settle timeout."""


@dataclass(frozen=True, slots=True)
class TakeLook:
    """Robust mean over pairs at standstill. Reply: Look (a failed look is a reply, not an error)."""

    pairs: int
    source: Literal["stereo", "mono"] = "stereo"


@dataclass(frozen=True, slots=True)
class StartOdometry:
    """Start the camera's own trajectory. Reply: None."""


@dataclass(frozen=True, slots=True)
class TimePairs:
    """Watch some pairs of the odometry that is on. Reply: PairTiming."""

    pairs: int = 8


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


def expect(reply: object, expected: type[Reply]) -> Reply:
    """The engine's reply, which must be of the type that the request promises; anything else is a defect."""
    if not isinstance(reply, expected):
        raise TypeError(f"reply is {type(reply).__name__}, expected {expected.__name__}")
    return reply
