"""What the server has learnt since it started: last look, local calibration, previewed plan, start of the run."""

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from server.calibration.calibration_life import LocalCalibration
from server.calibration.contracts import Array, CameraRotationEstimate
from server.calibration.joint_estimate import JointEstimate
from server.calibration.joint_observations import LookAt, OdometryRun
from server.jobs.records import CalibrationRecord, ComparedMove, ErrorMm, LookRecord, MoveRecord
from server.jobs.requests import MachineReading
from server.motion.contracts import JointTrajectory, PathPlan
from server.targets.contracts import AnchoredTarget
from server.targets.taught import TaughtObject
from server.vision.contracts import Look


@dataclass(frozen=True, slots=True)
class LookTaken:
    """A look with the joints it was taken at; they belong together or not at all.

    `look`: by the camera as the calibration found it; `raw`: by the camera file, for what estimates or compares.
    """

    look: Look
    reading: MachineReading
    error: ErrorMm | None
    record: LookRecord
    raw: Look


@dataclass(frozen=True, slots=True)
class PreviewedPlan:
    """A plan that was shown. It is executed by its hash only, before it expires, from where it was made and looked."""

    plan: PathPlan
    plan_hash: str
    q_ref_start: Array
    q_look: Array  # the encoders at the look (n,) [rad]
    q_goal: Array
    T_base_tcp_goal: Array
    before: ErrorMm
    predicted_sigma_mm: tuple[float, float, float]
    largest_source: str  # of what is predicted on its worst axis, with its remedy
    t_made_ns: int
    expires_ns: int


@dataclass(slots=True)
class Knowledge:
    """Mutable on purpose: the one place where jobs leave what later jobs build on."""

    last_look: LookTaken | None = None
    mount_rotation_estimate: CameraRotationEstimate | None = None
    calibration_record: CalibrationRecord | None = None
    previewed_plan: PreviewedPlan | None = None
    q_start: Array | None = None
    T_base_ooi: Array | None = None
    stall_rad: Array | None = None
    moves: list[MoveRecord] = field(default_factory=list)
    compared_moves: list[ComparedMove] = field(default_factory=list)
    odometry_runs: list[OdometryRun] = field(default_factory=list)
    look_observations: list[LookAt] = field(default_factory=list)
    joint_estimate: JointEstimate | None = None
    # Camera and prints as the last estimate found them: mean, covariance
    lens_estimate: tuple[Array, Array] | None = None
    # Where each joint rested in its play (n,), -1 to 1, by the last reading of the encoders
    backlash_sides: Array | None = None
    kept_calibration: LocalCalibration | None = None  # the calibration as a thing that is kept, shown and expires
    target: AnchoredTarget | TaughtObject | None = None  # the object of interest, where it is not known by markers
    found_marks: tuple[AnchoredTarget, ...] = ()  # holes and rings that were found last, any of which may be the target
    calibration_note: str = ""  # why a kept calibration was not taken up, or is not kept
    unix_minus_mono_s: float = 0.0  # 0 in virtual time

    @property
    def has_looked_for_wall(self) -> bool:
        """Whether a look for a wall was taken since the server began: one is known, or the look showed none."""
        return self.T_base_ooi is not None or self.last_look is not None

    def unix_s(self, t_mono_ns: int) -> float:
        """The calendar's time at a moment of the monotonic clock [s]."""
        return t_mono_ns * 1e-9 + self.unix_minus_mono_s

    def forget_sight(self) -> None:
        """Nothing seen, and nothing planned from it, is acted upon any more; the wall's place is kept as a limit."""
        self.last_look = self.previewed_plan = None

    def use_target(self, target: AnchoredTarget | TaughtObject | None) -> None:
        """Another object of interest: what was seen of the former one is not used any more."""
        self.target = target
        self.forget_sight()
        self.look_observations.clear()  # they saw another object
        self.joint_estimate = None
        self.moves.clear()

    def forget_calibration(self) -> None:
        """Nothing learnt about this machine's mount and map is used any more."""
        self.mount_rotation_estimate = self.calibration_record = self.joint_estimate = self.kept_calibration = (
            self.lens_estimate
        ) = None
        self.calibration_note = ""
        self.odometry_runs.clear()
        self.look_observations.clear()


def plan_hash(plan: PathPlan) -> str:
    """Short fingerprint of what would be sent: an Execute that names another plan fires nothing."""
    return fingerprint(() if plan.trajectory is None else (("", plan.trajectory),))


def fingerprint(motions: Iterable[tuple[str, JointTrajectory]]) -> str:
    """Of motions in their order, each with a word for what it is."""
    digest = hashlib.sha256()
    for word, motion in motions:
        digest.update(word.encode())
        for part in (motion.t_s, motion.q, motion.qd, motion.qdd):
            digest.update(np.ascontiguousarray(part, dtype=np.float64).tobytes())
    return digest.hexdigest()[:16]
