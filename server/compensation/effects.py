"""Which effects of a machine file the server can do something about, and what it does."""

from dataclasses import dataclass

from machine.effects.entries import EffectEntry
from server.calibration.kinematic_errors import usual_play

KINEMATICS_USE_TEXT = "kinematics"
KINEMATICS_ONLY_USE_TEXT = "kinematics, until a calibration learns its own map"  # the learnt map has no number for it
#: What the diagnosed machine changes, by effect.
# fmt: off
COMPENSATION_TEXT_BY_EFFECT = {
    "gravity_sag": KINEMATICS_USE_TEXT, "link_length_error": KINEMATICS_USE_TEXT, "encoder_bias": KINEMATICS_USE_TEXT,
    "base_compliance": KINEMATICS_ONLY_USE_TEXT,
    "base_tilt": KINEMATICS_ONLY_USE_TEXT, "joint_axis_tilt": KINEMATICS_ONLY_USE_TEXT,
    "encoder_scale": KINEMATICS_ONLY_USE_TEXT,
    "encoder_eccentricity": KINEMATICS_ONLY_USE_TEXT, "payload_error": KINEMATICS_ONLY_USE_TEXT, "backlash": "side of "
    "approach",
    "hand_eye_rotation": "camera mount", "hand_eye_translation": "camera mount", "valve_deadband": "first stall",
    "transport_delay": "reported, not needed",  # a whole trajectory is played by the PLC's clock: it only starts later
}
# fmt: on


@dataclass(frozen=True, slots=True)
class EffectsByUse:
    """Effects that are compensated, and those that are not."""

    compensated: tuple[EffectEntry, ...]
    uncompensated: tuple[EffectEntry, ...]

    def lines(self) -> tuple[str, ...]:
        """One line an effect, for the state and the log."""
        lines = [f"{_effect_label(effect)}: {COMPENSATION_TEXT_BY_EFFECT[effect.name]}" for effect in self.compensated]
        return tuple(lines + [f"{_effect_label(effect)}: not compensated" for effect in self.uncompensated])


def _effect_label(one: EffectEntry) -> str:
    return one.name if one.joint is None else f"{one.name}, joint {one.joint}"


def sort_effects(entries: tuple[EffectEntry, ...]) -> EffectsByUse:
    """Effects by whether the server can compensate them."""
    used = tuple(entry for entry in entries if _is_compensable(entry))
    return EffectsByUse(used, tuple(entry for entry in entries if not _is_compensable(entry)))


def _is_compensable(one: EffectEntry) -> bool:
    """A known width does not help where the joint's side in its play is not followed."""
    if one.name == "backlash" and one.joint is not None:
        return bool(usual_play(one.joint)[one.joint - 1] > 0.0)
    return one.name in COMPENSATION_TEXT_BY_EFFECT
