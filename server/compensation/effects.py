"""Which effects of a machine file the server can do something about, and what it does."""

from dataclasses import dataclass

from machine.effects.entries import EffectEntry

#: What the diagnosed machine changes, by effect.
COMPENSATED = {
    "gravity_sag": "kinematics",
    "base_compliance": "kinematics",
    "base_tilt": "kinematics",
    "joint_axis_tilt": "kinematics",
    "link_length_error": "kinematics",
    "encoder_bias": "kinematics",
    "encoder_scale": "kinematics",
    "encoder_eccentricity": "kinematics",
    "payload_error": "kinematics",
    "backlash": "side of approach",
    "hand_eye_rotation": "camera mount",
    "hand_eye_translation": "camera mount",
    "valve_deadband": "first stall",
    "transport_delay": "said, not needed",  # a whole trajectory is played by the PLC's clock: it only starts later
}


@dataclass(frozen=True, slots=True)
class Sorted:
    """Effects that are compensated, and those that are not."""

    used: tuple[EffectEntry, ...]
    left: tuple[EffectEntry, ...]

    def told(self) -> tuple[str, ...]:
        """One line an effect, for the state and the log."""
        lines = [f"{_place(one)}: {COMPENSATED[one.name]}" for one in self.used]
        return tuple(lines + [f"{_place(one)}: not compensated" for one in self.left])


def _place(one: EffectEntry) -> str:
    return one.name if one.joint is None else f"{one.name}, joint {one.joint}"


def sort_effects(entries: tuple[EffectEntry, ...]) -> Sorted:
    """Effects by whether the server can compensate them."""
    used = tuple(one for one in entries if one.name in COMPENSATED)
    return Sorted(used, tuple(one for one in entries if one.name not in COMPENSATED))
