"""Layout of each effect's parameters in the arrays of the kernel and of the static maps."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from machine.effects import kernel
from machine.effects.registry import EFFECTS, effect_of
from machine.effects.spec import Effect, Parameter, Scope
from machine.errors import MachineError
from machine.rotations import Array

# Columns behind the kernel's own, used by structure, camera and clocks.
SAG, LENGTH_A, LENGTH_D, TILT_X, TILT_Y = 30, 31, 32, 33, 34
N_JOINT_PARAMETERS = 35
CLOCK_OFFSET, CLOCK_RATE_PPM, BASE_TILT, BASE_COMPLIANCE = 4, 5, slice(6, 9), 9
FOCAL, PRINCIPAL, K1, MARKER_SIZE = 10, slice(11, 13), 13, 14
HAND_EYE_ROTATION, HAND_EYE_TRANSLATION, STEREO = slice(15, 18), slice(18, 21), slice(21, 24)
LATENCY, READOUT, ODOMETRY_SCALE, STAMP_ROW, CLOCK_ZERO = 24, 25, 26, 27, 28
TOOL_MARKER_ROTATION, TOOL_MARKER_TRANSLATION = slice(29, 32), slice(32, 35)
CAMERA_PARAMETER_COLUMNS = [
    *range(FOCAL, STEREO.stop),
    READOUT,
    ODOMETRY_SCALE,
    STAMP_ROW,
    *range(29, 35),
]  # no pose of the arm
N_MACHINE_PARAMETERS = 35

# (effect, parameter, option or "") -> column; a direction's size stands in as many columns as the vector has.
_JOINT: dict[tuple[str, str, str], int] = {
    ("reference_quantisation", "step_rad", ""): kernel.STEP,
    ("reference_rate_limit", "rate_rad_s", ""): kernel.RATE,
    ("controller_gain_error", "gain_frac", ""): kernel.KP_GAIN,
    ("controller_lag_error", "lag_frac", ""): kernel.PT1_LAG,
    ("controller_saturation", "limit_frac", ""): kernel.U_LIMIT,
    ("valve_hysteresis", "half_width_frac", ""): kernel.HYSTERESIS,
    ("valve_lag", "time_constant_s", ""): kernel.LAG,
    ("valve_deadband", "half_width_frac", "kept"): kernel.DEADBAND,
    ("valve_deadband", "half_width_frac", "lost"): kernel.DEADBAND_LOST,
    ("flow_gain_error", "gain_frac", ""): kernel.FLOW,
    ("valve_asymmetry", "gain_frac", ""): kernel.ASYMMETRY,
    ("load_droop", "droop_frac", ""): kernel.DROOP,
    ("internal_leakage", "drift_rad_s", ""): kernel.LEAK,
    ("stiction", "breakaway_frac", "below_a_fifth"): kernel.BREAKAWAY,
    ("stiction", "breakaway_frac", "at_reversals"): kernel.BREAKAWAY_ONCE,
    ("joint_friction", "compression_rad", ""): kernel.FRICTION,
    ("oil_compliance", "period_s", ""): kernel.OIL_PERIOD,
    ("oil_compliance", "damping", ""): kernel.OIL_DAMPING,
    ("encoder_bias", "bias_rad", ""): kernel.BIAS,
    ("encoder_scale", "scale_frac", ""): kernel.SCALE,
    ("encoder_eccentricity", "amplitude_rad", ""): kernel.ECC_AMPLITUDE,
    ("encoder_eccentricity", "order", ""): kernel.ECC_ORDER,
    ("encoder_eccentricity", "phase_rad", ""): kernel.ECC_PHASE,
    ("backlash", "width_rad", ""): kernel.BACKLASH,
    ("link_flexibility", "gain", ""): kernel.FLEX_GAIN,
    ("link_flexibility", "frequency_hz", ""): kernel.FLEX_HZ,
    ("link_flexibility", "damping", ""): kernel.FLEX_DAMPING,
    ("gravity_sag", "compliance_rad_nm", ""): SAG,
    ("link_length_error", "error_m", "a"): LENGTH_A,
    ("link_length_error", "error_m", "d"): LENGTH_D,
    ("joint_axis_tilt", "tilt_rad", "x"): TILT_X,
    ("joint_axis_tilt", "tilt_rad", "y"): TILT_Y,
}
_MACHINE: dict[tuple[str, str], int] = {
    ("transport_delay", "delay_s"): kernel.DELAY,
    ("packet_loss", "loss_frac"): kernel.LOSS,
    ("supply_droop", "flow_limit_frac"): kernel.FLOW_LIMIT,
    ("payload_error", "mass_kg"): kernel.PAYLOAD,
    ("clock_offset", "offset_s"): CLOCK_OFFSET,
    ("clock_drift", "rate_ppm"): CLOCK_RATE_PPM,
    ("clock_drift", "zero_s"): CLOCK_ZERO,
    ("base_tilt", "tilt_rad"): BASE_TILT.start,
    ("base_compliance", "compliance_rad_nm"): BASE_COMPLIANCE,
    ("focal_length_error", "scale_frac"): FOCAL,
    ("principal_point_error", "shift_px"): PRINCIPAL.start,
    ("lens_distortion", "k1"): K1,
    ("marker_size_error", "scale_frac"): MARKER_SIZE,
    ("hand_eye_rotation", "angle_rad"): HAND_EYE_ROTATION.start,
    ("hand_eye_translation", "distance_m"): HAND_EYE_TRANSLATION.start,
    ("stereo_misalignment", "angle_rad"): STEREO.start,
    ("camera_latency", "latency_s"): LATENCY,
    ("rolling_shutter", "readout_s"): READOUT,
    ("rolling_shutter", "stamp_row"): STAMP_ROW,
    ("odometry_scale", "scale_frac"): ODOMETRY_SCALE,
    ("tool_marker_rotation", "angle_rad"): TOOL_MARKER_ROTATION.start,
    ("tool_marker_translation", "distance_m"): TOOL_MARKER_TRANSLATION.start,
}


@dataclass(frozen=True, slots=True)
class ParameterSlot:
    """One number that a fit may move: where it stands, its bounds, neutral, and a step that it feels.

    `typical_max`: what good machines have, and the ruler of steps and scans; `upper_bound`: where a fit has to stop.
    `component_index`: 0 for plain numbers, else the component of a direction's vector. `joint`: 1-based, None for the
    machine.
    `size_scale`: how many times larger sizes are on this machine than those that the effect's prior was made for.
    """

    effect: str
    parameter: str
    joint: int | None
    option: str
    scope: Scope
    column: int
    lower_bound: float
    typical_max: float
    upper_bound: float
    neutral_value: float
    start_value: float
    component_index: int = 0
    size_scale: float = 1.0

    @property
    def spec(self) -> Parameter:
        """What the catalogue says of this number."""
        return next(parameter for parameter in effect_of(self.effect).parameters if parameter.name == self.parameter)


@dataclass(frozen=True, slots=True)
class ParameterSets:
    """Parameters of many sets: joints (sets, n, N_JOINT_PARAMETERS), machine (sets, N_MACHINE_PARAMETERS). Written in
    place."""

    joint_parameters: Array
    machine_parameters: Array

    @property
    def set_count(self) -> int:
        """Number of parameter sets."""
        return self.joint_parameters.shape[0]

    def put(
        self, slot: ParameterSlot, values: float | Array, sets: slice | int | NDArray[np.int64] = slice(None)
    ) -> None:
        """Write one number into some sets (all without `sets`)."""
        if slot.joint is None:
            self.machine_parameters[sets, slot.column] = values
        else:
            self.joint_parameters[sets, slot.joint - 1, slot.column] = values

    def get(self, slot: ParameterSlot, which: int = 0) -> float:
        """Read one number of one set."""
        if slot.joint is None:
            return float(self.machine_parameters[which, slot.column])
        return float(self.joint_parameters[which, slot.joint - 1, slot.column])

    def repeated_sets(self, sets: int) -> "ParameterSets":
        """This single set, `sets` times, to be written on."""
        if self.set_count != 1:
            raise MachineError(f"parameters hold {self.set_count} sets; give one to repeat")
        return ParameterSets(
            np.repeat(self.joint_parameters, sets, axis=0), np.repeat(self.machine_parameters, sets, axis=0)
        )


def neutral_sets(n_joints: int, sets: int = 1) -> ParameterSets:
    """Every effect at neutral."""
    joint, machine = _neutral_parameters()
    return ParameterSets(np.tile(joint, (sets, n_joints, 1)), np.tile(machine, (sets, 1)))


@cache
def _neutral_parameters() -> tuple[Array, Array]:
    """A joint's numbers (N_JOINT_PARAMETERS,) and the machine's (N_MACHINE_PARAMETERS,)."""
    joint, machine = np.zeros(N_JOINT_PARAMETERS), np.zeros(N_MACHINE_PARAMETERS)
    for effect in EFFECTS:
        for parameter in effect.parameters:
            for column in _parameter_columns(effect, parameter.name):
                (machine if effect.scope == "machine" else joint)[column] = parameter.neutral_value
    return joint, machine


def _parameter_columns(effect: Effect, parameter: str) -> list[int]:
    if effect.scope == "machine":
        first = _MACHINE[effect.name, parameter]
        return list(range(first, first + (len(effect.direction.default_vector) if effect.direction else 1)))
    options = effect.quantity_choice.options if effect.quantity_choice else ("",)
    return [_JOINT[effect.name, parameter, option] for option in options]


def column_of(effect: Effect, parameter: str, option: str = "") -> int:
    """The (first) column of a parameter; without an option, of the choice's first one."""
    if effect.scope == "machine":
        return _MACHINE[effect.name, parameter]
    return _JOINT[
        effect.name, parameter, option or (effect.quantity_choice.options[0] if effect.quantity_choice else "")
    ]


def slots_of(name: str, joint: int | None, option: str = "") -> tuple[ParameterSlot, ...]:
    """What a fit moves for one effect, sizes before shapes; a direction gives one number per fitted component.

    Raises: MachineError: no such effect, or a joint where none belongs (or none where one does).
    """
    effect = effect_of(name)
    if (joint is None) != (effect.scope == "machine"):
        raise MachineError(f"effect {name}: joint = {joint}; it belongs to {'the machine' if joint else 'one joint'}")
    option = option or (effect.quantity_choice.options[0] if effect.quantity_choice else "")
    slots: list[ParameterSlot] = []
    for parameter in sorted(effect.parameters, key=lambda one: one.role != "size"):
        column = column_of(effect, parameter.name, option)
        bounds = (parameter.plausible_min, parameter.plausible_max, parameter.highest_value, parameter.neutral_value)
        if effect.direction is None:
            slots.append(
                ParameterSlot(name, parameter.name, joint, option, effect.scope, column, *bounds, parameter.start_value)
            )
            continue
        for index, along in enumerate(effect.direction.default_vector[: effect.direction.n_fitted_components]):
            around = (-parameter.plausible_max, parameter.plausible_max, parameter.plausible_max, 0.0)
            start = parameter.start_value if along else 0.3 * parameter.start_value
            slots.append(
                ParameterSlot(name, parameter.name, None, "", "machine", column + index, *around, start, index)
            )
    return tuple(slots)
