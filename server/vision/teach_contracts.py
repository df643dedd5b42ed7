"""What teaching a marker layout takes and gives: views, settings, and the layout with its covariance or a reason."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from server.vision.contracts import Array


class TeachStatus(Enum):
    """How teaching ended."""

    OK = "ok"
    NO_MARKERS = "no_markers"
    TOO_FEW_VIEWS = "too_few_views"
    TOO_ALIKE = "too_alike"  # views from one direction only
    NOT_CONNECTED = "not_connected"  # markers that are never seen together
    CONTRADICTION = "contradiction"  # a marker moved, an id twice, a wrong side
    NOT_DETERMINED = "not_determined"  # solved, but not well enough


@dataclass(frozen=True, slots=True)
class TeachView:
    """Markers in one stereo pair at rest: corners (4, 2) [raw px] by id in each eye."""

    left_corners_px: Mapping[int, Array]
    right_corners_px: Mapping[int, Array]
    repeated_ids: frozenset[int] = frozenset()  # ids seen at two places of one image


@dataclass(frozen=True, slots=True)
class TeachSettings:
    """What corners, prints and the baseline are worth, and when a layout is believed."""

    sigma_px: float = 0.06  # one corner coordinate; the residuals may raise it
    side_sigma_m: float = 0.0002  # of a printed side measured by ruler
    baseline_sigma_frac: float = 0.002  # of the camera file's baseline
    views_min: int = 4  # that differ from each other
    view_apart_deg: float = 3.0  # two views differ from this angle on ...
    view_apart_frac: float = 0.10  # ... or from this share of the distance on
    spread_min_deg: float = 15.0  # between the two outermost viewing directions
    position_sigma_max_m: float = 0.001
    angle_sigma_max_deg: float = 0.3
    residual_max_px: float = 0.5  # rms above which a rigid layout does not explain the images
    sighting_max_px: float = 0.3  # rms of one marker in one view, or six times the usual one
    side_error_max_frac: float = 0.002  # between print and stereo, or three sigma


@dataclass(frozen=True, slots=True)
class TaughtMarker:
    """One marker of the layout.

    `covariance` (6, 6) of T_on_marker: rotation vector [rad] by left perturbation in the object's axes, translation
    [m]. `side_m` is the best of print and images together, `stereo_side_m` by the images and the baseline alone.
    """

    marker_id: int
    side_m: float
    side_sigma_m: float
    printed_side_m: float | None
    stereo_side_m: float
    stereo_side_sigma_m: float
    T_on_marker: Array
    covariance: Array
    n_views: int
    residual_rms_px: float


@dataclass(frozen=True, slots=True)
class TaughtLayout:
    """The layout, or why there is none: `markers` is empty unless status is OK."""

    status: TeachStatus
    reason: str
    markers: tuple[TaughtMarker, ...]
    n_views: int
    spread_deg: float  # between the outermost viewing directions; NaN where unknown
    residual_rms_px: float
    baseline_frac: float  # by which the images and prints want the baseline longer
    baseline_sigma_frac: float
    notes: tuple[str, ...] = field(default=())  # what was left out, and what to look at

    @property
    def sigma_mm(self) -> float:
        """The worst standard deviation of a marker's place, along its worst direction [mm]."""
        return max((1e3 * position_sigma_m(marker) for marker in self.markers), default=float("nan"))


def position_sigma_m(marker: TaughtMarker) -> float:
    """Standard deviation of a marker's place along its worst direction [m]."""
    return _largest_sigma(marker.covariance[3:, 3:])


def angle_sigma_rad(marker: TaughtMarker) -> float:
    """Standard deviation of a marker's orientation about its worst axis [rad]."""
    return _largest_sigma(marker.covariance[:3, :3])


def _largest_sigma(covariance: Array) -> float:
    return float(np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 0.0)))
