"""What a plan may ask for while the machine moves: pairs as they come, corrections, a stop."""

from dataclasses import dataclass
from typing import Literal

from server.calibration.contracts import Array
from server.motion.contracts import JointTrajectory
from server.vision.contracts import ObjectPose


@dataclass(frozen=True, slots=True)
class StartMove:
    """Begin a trajectory and do not wait for its end. Reply: None. `Correct`, `EndMove` and `StopMove` belong to it."""

    trajectory: JointTrajectory
    purpose: str


@dataclass(frozen=True, slots=True)
class NextPair:
    """Wait for a pair newer than number `after`, at most `silence_max_s` since the last one. Reply: PairSeen.

    `time_offset_s`: add to the camera's time to get the encoders'.
    """

    after: int
    silence_max_s: float
    time_offset_s: float


@dataclass(frozen=True, slots=True)
class PairSeen:
    """One pair as it came, with the encoders at its exposure and how the motion stands.

    `fault`: why it must not be acted upon (silent camera, old or unfit picture, no encoders for it); empty when it may.
    `tail`: what became of the last `Correct`; taken and refused are reported once.
    """

    number: int
    fault: str
    tool: ObjectPose | None
    ooi: ObjectPose | None
    q_rad: Array | None
    t_play_s: float
    ended: bool
    tail: Literal["none", "pending", "taken", "refused"] = "none"
    tail_text: str = ""


@dataclass(frozen=True, slots=True)
class Correct:
    """Replace the running trajectory from knot `first` on. Reply: None immediately; later pairs report the result."""

    trajectory: JointTrajectory
    first: int


@dataclass(frozen=True, slots=True)
class EndMove:
    """Wait for the end of what was begun. Reply: None; a stop or refusal fails the job."""


@dataclass(frozen=True, slots=True)
class StopMove:
    """Ramp down now and hold. Reply: None, at rest."""

    reason: str


Steer = StartMove | NextPair | Correct | EndMove | StopMove
