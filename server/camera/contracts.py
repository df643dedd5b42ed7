"""What goes to the vision process and what it reports: frozen data, since it crosses a process boundary."""

from dataclasses import dataclass
from typing import Literal, Protocol

from server.camera.sources.settings import SourceSettings
from server.targets.contracts import AnchoredTarget, SurfacePatch
from server.targets.round_marks import RoundMark
from server.targets.taught import ObjectBox, TaughtObject, TaughtView
from server.vision.contracts import Array, Image, OdometryPose, PairObservation

PoseSourceName = Literal["stereo", "mono"]


@dataclass(frozen=True, slots=True)
class VisionSettings:
    """How the vision process works.

    `threads`: OpenCV's own; one, since markers and odometry already run side by side.
    `mask_scale`: the tool marker's square is blown up by this much to cover the tool's plate in odometry.
    `mask_left`, `mask_right`: polygons (k, 2) [px] over the machine itself, as the settings have them.
    `exposure_slack_s`: a mapped exposure may lie this much behind the true one (the camera's smallest latency).
    """

    source: SourceSettings
    threads: int = 1
    preview_width_px: int = 960
    preview_quality: int = 75
    preview_rate_hz: float = 10.0
    mask_scale: float = 2.0
    mask_left: tuple[Array, ...] = ()
    mask_right: tuple[Array, ...] = ()
    exposure_slack_s: float = 0.2


@dataclass(frozen=True, slots=True)
class StereoFrame:
    """One raw stereo pair. Grey (h, w) uint8 views of one buffer; `t_exposure_ns` on the camera's clock.

    `connection_number` counts the connections of the source: a new one may have a new clock.
    """

    left: Image
    right: Image
    t_exposure_ns: int
    t_receive_mono_ns: int
    sequence: int
    connection_number: int = 0


class StereoSource(Protocol):
    """Anything that gives stereo pairs, the newest first."""

    @property
    def skipped(self) -> int:
        """Pairs passed over so far because newer ones were there."""
        ...

    @property
    def state(self) -> str:
        """Empty while all is well, else what is wrong and what is done about it."""
        ...

    @property
    def ended(self) -> bool:
        """Whether no pair will ever come again."""
        ...

    def read(self, timeout_s: float) -> StereoFrame | None:
        """The newest pair not yet given out; None when none came in time."""
        ...

    def close(self) -> None:
        """Let go of the camera."""
        ...


@dataclass(frozen=True, slots=True)
class FrameReport:
    """One processed pair.

    `t_exposure_mapped_ns`: the exposure on the PC's monotonic clock, late by the camera's smallest latency.
    `warnings` forbid the use of this pair in a look; `n_skipped` counts since the start of the process; `odometry_run`
    is the number under which the odometry was switched on, 0 before the first.
    """

    observation: PairObservation
    t_receive_mono_ns: int
    t_exposure_mapped_ns: int
    sequence: int
    pose_source: PoseSourceName
    odometry: OdometryPose | None
    fps: float
    process_ms: float
    n_skipped: int
    warnings: tuple[str, ...]
    sharpness: float
    preview_jpeg: bytes | None
    preview_width_px: int = 0
    odometry_run: int = 0

    @property
    def fit_for_look(self) -> bool:
        """Whether the images are fit for a look."""
        return not self.warnings


@dataclass(frozen=True, slots=True)
class StreamNotice:
    """The source's state has changed; empty text means it is well again."""

    t_mono_ns: int
    text: str


@dataclass(frozen=True, slots=True)
class SignOfLife:
    """The process goes on, whether or not its camera gives pictures."""


@dataclass(frozen=True, slots=True)
class OdometryMap:
    """Where the points lie that an odometry run was fitted to, thinned: (n, 3) in its own vo frame [m].

    `still_masks` (h, w): of the left and the right eye, 255 over what stood still in the run's pictures; None: not
    requested, or the camera did not move.
    """

    points_vo: Array
    odometry_run: int
    still_masks: tuple[Image | None, Image | None] = (None, None)


@dataclass(frozen=True, slots=True)
class OdometryCommand:
    """Switch odometry on (from a fresh start frame) or off. `odometry_run`: a number that its poses and map carry.

    `still_masks_wanted`: its map shall say what stood still in the pictures, which costs a second at its end.
    """

    enabled: bool
    odometry_run: int
    still_masks_wanted: bool = False


@dataclass(frozen=True, slots=True)
class PoseSourceCommand:
    """Choose how marker poses are found."""

    pose_source: PoseSourceName


@dataclass(frozen=True, slots=True)
class QuitCommand:
    """End the vision process."""


@dataclass(frozen=True, slots=True)
class MeasureTargetCommand:
    """Measure the surface at a raw left pixel of the pair with that sequence number.

    `request_id`: echoed in the answer.
    """

    request_id: int
    pair_sequence: int
    pixel: tuple[float, float]
    roll_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class FindMarksCommand:
    """Find boreholes and rings of these diameters [m] in the pair with that sequence number.

    `request_id`: echoed in the answer; the marks' targets are numbered from it on.
    """

    request_id: int
    pair_sequence: int
    diameters_m: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class UseTargetCommand:
    """Serve this target as the object of interest; None: its markers again."""

    target: AnchoredTarget | TaughtObject | None


@dataclass(frozen=True, slots=True)
class TeachViewCommand:
    """Measure the landmarks of an object in the pair with that sequence number. `request_id`: echoed in the answer."""

    request_id: int
    pair_sequence: int
    object_box: ObjectBox


@dataclass(frozen=True, slots=True)
class ViewTaught:
    """The answer to a TeachViewCommand: the view, or why it cannot be used."""

    request_id: int
    view_or_reason: TaughtView | str


@dataclass(frozen=True, slots=True)
class TargetMeasured:
    """The answer to a MeasureTargetCommand: a target that can be used, or the refused patch."""

    request_id: int
    target_or_refused_patch: AnchoredTarget | SurfacePatch


@dataclass(frozen=True, slots=True)
class MarksFound:
    """The answer to a FindMarksCommand: each mark with its target, or the patch that cannot be one; or why none."""

    request_id: int
    marks_with_targets: tuple[tuple[RoundMark, AnchoredTarget | SurfacePatch], ...]
    reason: str


TargetCommand = MeasureTargetCommand | FindMarksCommand | UseTargetCommand | TeachViewCommand
TargetAnswer = TargetMeasured | MarksFound | ViewTaught
VisionCommand = OdometryCommand | PoseSourceCommand | TargetCommand | QuitCommand
VisionMessage = FrameReport | StreamNotice | OdometryMap | TargetAnswer | SignOfLife
