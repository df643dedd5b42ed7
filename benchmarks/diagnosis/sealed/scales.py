"""Every effect that is injected: where it may sit, its stage, and how large a first guess of its limit is."""

from dataclasses import dataclass

import numpy as np

from benchmarks.diagnosis.sealed.faults import Injected
from machine.rotations import Array

LOADED = (2, 3)
ALL = (1, 2, 3)


@dataclass(frozen=True)
class Kind:
    """One effect of the catalogue. `guess`: a size to begin the search of its detection limit with; `largest`."""

    name: str
    stage: str
    parameter: str
    joints: tuple[int, ...] | None
    guess: float
    largest: float
    limits: bool = False  # a limit: smaller is stronger
    signed: bool = False
    least: float = 0.0  # below it nothing may happen at all


KINDS = (
    Kind("clock_offset", "time", "offset_s", None, 0.01, 0.4, signed=True),
    Kind("clock_drift", "time", "rate_ppm", None, 100.0, 480.0, signed=True),
    Kind("transport_delay", "link", "delay_s", None, 0.005, 0.3),
    Kind("packet_loss", "link", "loss_frac", None, 0.005, 0.4, least=5e-4),
    Kind("reference_quantisation", "link", "step_rad", ALL, 1e-4, 0.008),
    Kind("reference_rate_limit", "link", "rate_rad_s", ALL, 0.12, 0.01, limits=True),
    Kind("controller_gain_error", "controller", "gain_frac", ALL, 0.01, 0.5, signed=True),
    Kind("controller_lag_error", "controller", "lag_frac", LOADED, 0.02, 0.8, signed=True),
    Kind("controller_saturation", "controller", "limit_frac", ALL, 0.25, 0.06, limits=True),
    Kind("valve_deadband", "actuator", "half_width_frac", ALL, 0.005, 0.15),
    Kind("valve_lag", "actuator", "time_constant_s", ALL, 0.02, 0.4),
    Kind("valve_hysteresis", "actuator", "half_width_frac", ALL, 0.003, 0.08),
    Kind("valve_asymmetry", "actuator", "gain_frac", ALL, 0.03, 0.5, signed=True),
    Kind("flow_gain_error", "actuator", "gain_frac", ALL, 0.02, 0.5, signed=True),
    Kind("supply_droop", "actuator", "flow_limit_frac", None, 0.5, 0.1, limits=True),
    Kind("internal_leakage", "actuator", "drift_rad_s", LOADED, 0.002, 0.04, signed=True),
    Kind("load_droop", "actuator", "droop_frac", LOADED, 0.04, 0.7, signed=True),
    Kind("stiction", "actuator", "breakaway_frac", ALL, 0.02, 0.2),
    Kind("backlash", "joint", "width_rad", ALL, 3e-4, 0.03),
    Kind("encoder_bias", "joint", "bias_rad", ALL, 2e-4, 0.2, signed=True),
    Kind("encoder_scale", "joint", "scale_frac", ALL, 5e-4, 0.08, signed=True),
    Kind("encoder_eccentricity", "joint", "amplitude_rad", ALL, 5e-4, 0.025),
    Kind("gravity_sag", "structure", "compliance_rad_nm", LOADED, 3e-8, 8e-6),
    Kind("link_length_error", "structure", "error_m", ALL, 5e-4, 0.15, signed=True),
    Kind("base_tilt", "structure", "tilt_rad", None, 2e-4, 0.08),
    Kind("base_compliance", "structure", "compliance_rad_nm", None, 2e-8, 5e-6),
    Kind("payload_error", "structure", "mass_kg", None, 10.0, 300.0),
    Kind("link_flexibility", "structure", "gain", ALL, 0.05, 1.6),
    Kind("joint_axis_tilt", "structure", "tilt_rad", ALL, 4e-4, 0.08, signed=True),
    Kind("focal_length_error", "camera", "scale_frac", None, 1e-3, 0.08, signed=True),
    Kind("principal_point_error", "camera", "shift_px", None, 1.0, 50.0),
    Kind("lens_distortion", "camera", "k1", None, 3e-3, 0.12, signed=True),
    Kind("marker_size_error", "camera", "scale_frac", None, 1e-3, 0.15, signed=True),
    Kind("hand_eye_rotation", "camera", "angle_rad", None, 1e-3, 0.2),
    Kind("hand_eye_translation", "camera", "distance_m", None, 2e-3, 0.2),
    Kind("stereo_misalignment", "camera", "angle_rad", None, 3e-4, 0.05),
    Kind("camera_latency", "camera", "latency_s", None, 0.01, 0.3, signed=True),
    Kind("rolling_shutter", "camera", "readout_s", None, 5e-3, 0.045, signed=True),
)
NOT_JUDGED = (  # the plants have no odometry; their oil, friction and tool are always the same, known by the baseline
    "odometry_scale", "joint_friction", "oil_compliance", "tool_marker_rotation", "tool_marker_translation",
)  # fmt: skip
BY_NAME = {kind.name: kind for kind in KINDS}
OPTIONS = {"link_length_error": ("a", "d"), "joint_axis_tilt": ("x", "y")}
DIRECTIONS = {
    "base_tilt": 2,  # about the upright there is nothing to see but an encoder's bias
    "principal_point_error": 2,
    "hand_eye_rotation": 3,
    "hand_eye_translation": 3,
    "stereo_misalignment": 3,
}
FOREIGN_SIZES = {  # name: joint or not, smallest and largest size
    "spool_rate_limit": (True, 0.25, 1.5),
    "thermal_gain_drift": (True, 0.05, 0.3),
    "gear_eccentricity": (True, 5e-4, 4e-3),
    "cable_tug": (True, 300.0, 3000.0),
    "dropped_samples": (False, 1.0, 1.0),
    "swapped_joints": (False, 1.0, 1.0),
    "loose_marker": (False, 0.006, 0.05),
}


def placed(kind: Kind, joint: int | None, size: float, rng: np.random.Generator) -> Injected:
    """An effect at a size, its sign, direction and shape drawn."""
    if kind.signed and rng.uniform() < 0.5:
        size = -size
    values = {kind.parameter: size}
    if kind.name == "encoder_eccentricity":
        values |= {"order": float(rng.integers(1, 4)), "phase_rad": float(rng.uniform(-3.0, 3.0))}
    if kind.name == "link_flexibility":
        values |= {"frequency_hz": float(np.exp(rng.uniform(0.2, 1.6))), "damping": float(rng.uniform(0.02, 0.15))}
    option = ""
    if kind.name in OPTIONS:
        option = str(rng.choice(OPTIONS[kind.name]))
        if kind.name == "link_length_error" and joint == 2:
            option = "a"  # d of lift and d of tilt are one direction, and so is their bias at one place
    direction: tuple[float, ...] = ()
    if kind.name in DIRECTIONS:
        direction = tuple(float(x) for x in _unit(rng, DIRECTIONS[kind.name], kind.name))
    return Injected(kind.name, joint, values, option, direction)


def _unit(rng: np.random.Generator, dims: int, name: str) -> Array:
    v = rng.normal(size=dims)
    v /= np.linalg.norm(v)
    return np.append(v, 0.0) if name == "base_tilt" else v


def scaled(kind: Kind, limit: float, factor: float) -> float:
    """A size `factor` times as strong as the limit, inside what is believable.

    For limits, strength goes as how much of the motion is cut: the size shrinks by the factor's root.
    """
    if kind.limits:
        return max(limit / factor**0.5, kind.largest)
    return min(limit * factor, kind.largest)
