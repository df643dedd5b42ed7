"""A local calibration is a thing with a life: made at one place and time, valid around it, and one day expired."""

from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from machine.rotations import geodesic_angle
from server.calibration.contracts import Array
from server.calibration.slip_monitor import ToolSeen

FUTURE_TIMESTAMP_MAX_S = 60.0  # a calibration from further in the future than this: the PC's clock was set back


class ValidityStatus(Enum):
    """Why a calibration may or may not be used now."""

    VALID = "valid"
    SLIPPED = "slipped"
    SHIFTED = "shifted"
    OTHER_METHOD = "other_method"
    TOO_OLD = "too_old"
    CLOCK = "clock"
    TOO_FAR = "too_far"
    TURNED = "turned"
    POSTURE = "posture"
    TEMPERATURE = "temperature"


@dataclass(frozen=True, slots=True)
class CalibrationValidity:
    """A status and, unless it is VALID, the reason: subject, value, limit, remedy."""

    status: ValidityStatus
    reason: str = ""

    @property
    def ok(self) -> bool:
        """Whether the calibration may be used."""
        return self.status is ValidityStatus.VALID


@dataclass(frozen=True, slots=True)
class CalibrationExpiry:
    """Around what and how long a calibration holds.

    The map from joints to tool is a local one: sag, play and joint zeros bend it with the posture. One metre takes in
    the way from the farthest start (0.9 m) to the stand-off; a joint that turned by more has another posture (another
    branch of the arm, a wrist turned over) even where the tool is near. Oil 25 K warmer changes the stall in the dead
    bands, steel by 0.3 mm a metre.
    """

    radius_m: float = 1.0
    turn_rad: float = float(np.deg2rad(30.0))
    joint_rad: float = float(np.deg2rad(60.0))
    age_max_s: float = 12.0 * 3600.0
    temperature_k: float = 25.0


@dataclass(frozen=True, slots=True)
class MadeAt:
    """Where and when: Unix time [s], encoders (n,) [rad], nominal T_base_tcp (4, 4), oil [deg C] or None."""

    t_unix_s: float
    q: Array
    T_base_tcp: Array
    oil_temperature_c: float | None = None


@dataclass(frozen=True, slots=True)
class LocalMap:
    """What the joint estimate knows beyond the rotation: poses on the flange (4, 4), kinematic errors (p,), its fit."""

    T_tcp_cam: Array
    T_tcp_tool: Array
    errors: Array
    scale: float
    misfit: float
    residual_rms_mm: float
    n_samples: int
    n_looks: int


@dataclass(frozen=True, slots=True)
class LocalCalibration:
    """The local calibration with all that is needed to judge, keep and hand it on.

    `R_tcp_cam` (3, 3) with `covariance` (3, 3) [rad^2] (left perturbation, TCP axes); `p_tcp_cam_m` (3,) of the machine
    file; `observability` smallest over largest information of the path, 0..1; `slip` why it is void until a
    person has looked, `shift` why it is until it is made again; or empty.
    """

    machine_id: str
    method: str
    R_tcp_cam: Array
    covariance: Array
    p_tcp_cam_m: Array
    from_nominal_deg: float
    time_offset_s: float
    residual_rms_mm: float
    residual_max_mm: float
    n_used: int
    path_length_m: float
    observability: float
    made_at: MadeAt
    tool_marker_pose: ToolSeen | None = None
    local_map: LocalMap | None = None
    expiry: CalibrationExpiry = field(default_factory=CalibrationExpiry)
    slip: str = ""
    shift: str = ""

    @property
    def sigmas_rad(self) -> Array:
        """Principal standard deviations of the rotation (3,) [rad], smallest first."""
        return np.sqrt(np.maximum(np.linalg.eigvalsh(self.covariance), 0.0))

    @property
    def weakest_axis_tcp(self) -> Array:
        """The axis (3,) about which least is known, TCP axes."""
        return np.linalg.eigh(self.covariance)[1][:, -1]

    def valid_at(
        self, t_unix_s: float, q: Array, T_base_tcp: Array, oil_temperature_c: float | None = None
    ) -> CalibrationValidity:
        """Whether it may be used now, with the machine there.

        Args:    q: encoders (n,) [rad]. T_base_tcp: nominal pose there (4, 4). oil_temperature_c: None where not known.
        """
        return (
            self._slip_or_shift_verdict()
            or self._age_verdict(t_unix_s)
            or self._displacement_verdict(q, T_base_tcp)
            or self._oil_temperature_verdict(oil_temperature_c)
            or CalibrationValidity(ValidityStatus.VALID)
        )

    def _slip_or_shift_verdict(self) -> CalibrationValidity | None:
        if self.slip:
            return CalibrationValidity(ValidityStatus.SLIPPED, self.slip)
        return CalibrationValidity(ValidityStatus.SHIFTED, self.shift) if self.shift else None

    def _age_verdict(self, t_unix_s: float) -> CalibrationValidity | None:
        age_s, limit_s = t_unix_s - self.made_at.t_unix_s, self.expiry.age_max_s
        if age_s < -FUTURE_TIMESTAMP_MAX_S:
            text = f"the calibration is from {-age_s / 60.0:.0f} min in the future: the clock was set back; calibrate"
            return CalibrationValidity(ValidityStatus.CLOCK, text)
        if age_s > limit_s:
            text = f"the calibration is {age_s / 3600.0:.1f} h old (limit {limit_s / 3600.0:.1f} h); calibrate"
            return CalibrationValidity(ValidityStatus.TOO_OLD, text)
        return None

    def _displacement_verdict(self, q: Array, T_base_tcp: Array) -> CalibrationValidity | None:
        far_m = float(np.linalg.norm(T_base_tcp[:3, 3] - self.made_at.T_base_tcp[:3, 3]))
        turn_rad = geodesic_angle(self.made_at.T_base_tcp[:3, :3], T_base_tcp[:3, :3])
        joint_rad = float(np.abs(q - self.made_at.q).max())
        limits = self.expiry
        if far_m > limits.radius_m:
            text = f"the tool is {far_m:.2f} m from where it was calibrated (limit {limits.radius_m:.2f} m)"
            return CalibrationValidity(ValidityStatus.TOO_FAR, f"{text}; calibrate here")
        if turn_rad > limits.turn_rad:
            return CalibrationValidity(
                ValidityStatus.TURNED, _angle_text("the tool has turned", turn_rad, limits.turn_rad)
            )
        if joint_rad > limits.joint_rad:
            return CalibrationValidity(
                ValidityStatus.POSTURE, _angle_text("a joint has turned", joint_rad, limits.joint_rad)
            )
        return None

    def _oil_temperature_verdict(self, oil_temperature_c: float | None) -> CalibrationValidity | None:
        before = self.made_at.oil_temperature_c
        if before is None or oil_temperature_c is None:
            return None
        change_k = oil_temperature_c - before
        if abs(change_k) <= self.expiry.temperature_k:
            return None
        text = (
            f"the oil is {change_k:+.0f} K from the calibration's (limit {self.expiry.temperature_k:.0f} K); calibrate"
        )
        return CalibrationValidity(ValidityStatus.TEMPERATURE, text)


def _angle_text(what: str, angle_rad: float, limit_rad: float) -> str:
    angle, limit = np.rad2deg(angle_rad), np.rad2deg(limit_rad)
    return f"{what} by {angle:.0f} deg since the calibration (limit {limit:.0f} deg); calibrate here"


def observability_text(calibration: LocalCalibration) -> str:
    """What the path showed, in words: how well the weakest turn is known and about which axis."""
    value = calibration.observability
    words = (
        "well determined about all axes"
        if value > 0.1
        else "fair"
        if value > 0.01
        else "nearly a straight line: one rotation is weakly determined"
    )
    axis = calibration.weakest_axis_tcp
    name = "xyz"[int(np.argmax(np.abs(axis)))]
    sigma_deg = float(np.rad2deg(calibration.sigmas_rad[-1]))
    return (
        f"{words} (smallest over largest information {value:.3f}); weakest about {name} of the TCP, {sigma_deg:.2f} deg"
    )
