"""What a local calibration takes and gives."""

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class CalibrationStatus(Enum):
    """How an estimate ended; only OK may be used."""

    OK = "ok"
    TOO_FEW = "too_few"
    DEGENERATE = "degenerate"
    POOR_FIT = "poor_fit"


@dataclass(frozen=True, slots=True)
class CameraTrack:
    """Left camera from odometry: times (n,) [s, camera clock mapped to the PC], `Ts_vo_cam` (n, 4, 4)."""

    t_s: Array
    Ts_vo_cam: Array


@dataclass(frozen=True, slots=True)
class EncoderTrack:
    """Encoder-based TCP: times (m,) [s, PLC clock mapped to the PC], `Ts_base_tcp` (m, 4, 4), joints `qs` (m, n)."""

    t_s: Array
    Ts_base_tcp: Array
    qs: Array | None = None


@dataclass(frozen=True, slots=True)
class MountRotation:
    """Rotation of the camera against the TCP, with its covariance (3, 3) [rad^2] (left perturbation, TCP axes)."""

    R_tcp_cam: Array
    covariance: Array


@dataclass(frozen=True, slots=True)
class CameraRotationEstimate:
    """The local calibration: how camera vectors turn into base vectors, here and now.

    `R_tcp_cam` with covariance (3, 3) [rad^2] (left perturbation, TCP axes) is what is carried to other orientations:
    R_base_cam = R_base_tcp @ R_tcp_cam. None unless status is OK.
    """

    status: CalibrationStatus
    reason: str
    method: str
    R_tcp_cam: Array | None = None
    covariance: Array | None = None
    time_offset_s: float = 0.0  # add to the camera track's time to get the encoder track's
    residual_rms_mm: float = float("nan")
    residual_max_mm: float = float("nan")
    n_used: int = 0
    observability: float = 0.0  # smallest information eigenvalue of the path over the largest, 0..1
    path_length_m: float = 0.0
