"""What vision hands to everybody else: frozen results, each with covariance, count used, status and reason."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


class PoseStatus(Enum):
    """What a pose may be used for."""

    OK = "ok"
    ORIENTATION_AMBIGUOUS = "orientation_ambiguous"  # position usable, orientation not
    NOT_SEEN = "not_seen"
    REJECTED = "rejected"  # seen, but residual, health or geometry forbids its use


# Words in the reason of a view or pose by which others know what was found; never written out a second time.
NO_WHITE_MARGIN_REASON = "no white margin"  # a print's sides are no edges by which to judge a picture
DUPLICATE_MARKER_REASON = "visible at two places"
MOVED_MARKER_REASON = "moved on its board"
EYES_SWAPPED_REASON = "left and right eye are swapped"
ROWS_DIFFER_REASON = "rows of the two eyes differ"


@dataclass(frozen=True, slots=True)
class MarkerView:
    """One marker in one stereo pair. Corners (4, 2) in raw (distorted) px, OpenCV order; None = the eye sees none."""

    marker_id: int
    corners_left_px: Array | None
    corners_right_px: Array | None
    residual_rms_px: float
    used: bool
    reason: str  # why it was not used; empty when it was


@dataclass(frozen=True, slots=True)
class ObjectPose:
    """Pose of the tool or the OOI in the left camera.

    `covariance` (6, 6): rotation vector [rad] (left perturbation, camera axes), then translation [m].
    `T_cam_object` and `covariance` are None when status is NOT_SEEN or REJECTED.
    """

    object_name: Literal["tool", "ooi"]
    status: PoseStatus
    reason: str
    T_cam_object: Array | None
    covariance: Array | None
    marker_ids: tuple[int, ...]
    residual_rms_px: float
    chi2_margin: float  # chi2 of the other planar solution minus this one's; inf when there is no rival


@dataclass(frozen=True, slots=True)
class PairObservation:
    """What one stereo pair shows. `t_exposure_ns` is the camera's own stamp (mid-exposure of the middle row).

    `fully_searched`: the whole picture was searched, not only where the markers were last; a second marker of the same
    id is found then.
    """

    t_exposure_ns: int
    tool: ObjectPose
    ooi: ObjectPose
    marker_views: tuple[MarkerView, ...]
    warnings: tuple[str, ...]
    fully_searched: bool = True


class ObjectPoseSource(Protocol):
    """Anything that finds tool and OOI in a stereo pair: ArUco is one; real tools and boreholes may follow."""

    def observe(self, left: Image, right: Image, t_exposure_ns: int) -> PairObservation:
        """Poses in one raw grey (h, w) stereo pair. Never raises on what the image shows; a failed look is a status."""
        ...


class LookStatus(Enum):
    """How a look ended."""

    OK = "ok"
    TOOL_NOT_SEEN = "tool_not_seen"
    OOI_NOT_SEEN = "ooi_not_seen"
    ORIENTATION_AMBIGUOUS = "orientation_ambiguous"
    NOT_AT_REST = "not_at_rest"
    NO_IMAGES = "no_images"
    REJECTED = "rejected"


@dataclass(frozen=True, slots=True)
class Look:
    """Robust mean over pairs at standstill. Poses None unless status is OK or ORIENTATION_AMBIGUOUS."""

    status: LookStatus
    reason: str
    T_cam_tool: Array | None = None
    T_cam_ooi: Array | None = None
    tool_covariance: Array | None = None  # (6, 6), as ObjectPose
    ooi_covariance: Array | None = None
    n_pairs: int = 0
    n_used: int = 0
    t_first_ns: int = 0
    t_last_ns: int = 0
    spread_mm: float = 0.0  # robust spread of tool-to-OOI position over the pairs
    corners_px: Mapping[int, tuple[Array | None, Array | None]] = field(default_factory=dict)  # mean, left and right


class OdometryStatus(Enum):
    """How far the odometry may be trusted."""

    OK = "ok"
    DEGRADED = "degraded"
    LOST = "lost"


@dataclass(frozen=True, slots=True)
class OdometryPose:
    """Left camera in the odometry's start frame `vo` at one exposure. Covariance as ObjectPose, since the start."""

    t_exposure_ns: int
    T_vo_cam: Array
    covariance: Array
    status: OdometryStatus
    reason: str
    n_points: int
