"""The catalogue in its order: stages from the clock to the camera."""

from machine.effects.catalogue import (
    backlash,
    base_compliance,
    base_tilt,
    camera_latency,
    clock_drift,
    clock_offset,
    controller_gain_error,
    controller_lag_error,
    controller_saturation,
    encoder_bias,
    encoder_eccentricity,
    encoder_scale,
    flow_gain_error,
    focal_length_error,
    gravity_sag,
    hand_eye_rotation,
    hand_eye_translation,
    internal_leakage,
    joint_axis_tilt,
    joint_friction,
    lens_distortion,
    link_flexibility,
    link_length_error,
    load_droop,
    marker_size_error,
    odometry_scale,
    oil_compliance,
    packet_loss,
    payload_error,
    principal_point_error,
    reference_quantisation,
    reference_rate_limit,
    rolling_shutter,
    stereo_misalignment,
    stiction,
    supply_droop,
    tool_marker_rotation,
    tool_marker_translation,
    transport_delay,
    valve_asymmetry,
    valve_deadband,
    valve_hysteresis,
    valve_lag,
)
from machine.effects.spec import Effect, Stage
from machine.errors import MachineError

EFFECTS: tuple[Effect, ...] = (
    clock_offset.EFFECT,
    clock_drift.EFFECT,
    transport_delay.EFFECT,
    packet_loss.EFFECT,
    reference_quantisation.EFFECT,
    reference_rate_limit.EFFECT,
    controller_gain_error.EFFECT,
    controller_lag_error.EFFECT,
    controller_saturation.EFFECT,
    valve_deadband.EFFECT,
    valve_lag.EFFECT,
    valve_hysteresis.EFFECT,
    valve_asymmetry.EFFECT,
    flow_gain_error.EFFECT,
    supply_droop.EFFECT,
    internal_leakage.EFFECT,
    load_droop.EFFECT,
    stiction.EFFECT,
    joint_friction.EFFECT,
    oil_compliance.EFFECT,
    backlash.EFFECT,
    encoder_bias.EFFECT,
    encoder_scale.EFFECT,
    encoder_eccentricity.EFFECT,
    gravity_sag.EFFECT,
    link_length_error.EFFECT,
    base_tilt.EFFECT,
    base_compliance.EFFECT,
    payload_error.EFFECT,
    link_flexibility.EFFECT,
    joint_axis_tilt.EFFECT,
    focal_length_error.EFFECT,
    principal_point_error.EFFECT,
    lens_distortion.EFFECT,
    marker_size_error.EFFECT,
    hand_eye_rotation.EFFECT,
    hand_eye_translation.EFFECT,
    tool_marker_rotation.EFFECT,
    tool_marker_translation.EFFECT,
    stereo_misalignment.EFFECT,
    camera_latency.EFFECT,
    rolling_shutter.EFFECT,
    odometry_scale.EFFECT,
)
_BY_NAME = {effect.name: effect for effect in EFFECTS}
NAMES: tuple[str, ...] = tuple(_BY_NAME)


def effect_named(name: str) -> Effect | None:
    """The effect of this name; None if the catalogue has none."""
    return _BY_NAME.get(name)


def effect_of(name: str) -> Effect:
    """The effect of a name that the catalogue is known to have. Raises: MachineError: it has none."""
    effect = effect_named(name)
    if effect is None:
        raise MachineError(f"effect {name!r} is not in the catalogue; see machine/effects/registry.py")
    return effect


def effects_of(stage: Stage) -> tuple[Effect, ...]:
    """The effects of one stage, in the catalogue's order."""
    return tuple(effect for effect in EFFECTS if effect.stage == stage)
