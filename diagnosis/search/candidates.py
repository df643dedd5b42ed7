"""The effects that a stage's residual can name: what a fit moves for each, and where it looks first."""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from machine.effects.layout import ParameterSets, ParameterSlot, slots_of
from machine.effects.registry import effect_of, effects_of
from machine.effects.spec import Effect, Stage
from machine.rotations import Array

SCAN_SIZE_FRACS = (0.004, 0.012, 0.035, 0.1, 0.25, 0.6)  # of the bound: where the scan looks, neutral 0
BENT_BY_GRAVITY, CRANE_NM = ("gravity_sag", "base_compliance"), 3e4
EXTENDED_SCAN_COUNT = 3  # sizes beyond those of good machines
LIMIT_SCAN_COUNT = 9  # sizes scanned between the bounds of an effect that limits (neutral 1 or inf)
DENSE_SCAN_COUNT_BY_EFFECT = {
    "stiction": 50
}  # sizes of effects whose cost has a valley far narrower than the way there
SCAN_PHASES_RAD = (-2.0, -0.4, 1.2, 2.7)
OSCILLATION_EFFECTS = ("link_flexibility",)  # effects with a frequency of their own
SCAN_FREQUENCIES_HZ = tuple(np.geomspace(0.8, 6.0, 24))  # the cost has a valley a tenth of a frequency wide
SUPPLY_DROOP_EFFECT = "supply_droop"  # couples all joints
#: Effects of the joint stage that the encoder shows against the valve command.
ENCODER_VISIBLE_EFFECTS = ("encoder_scale", "encoder_eccentricity")
#: Effects of the joint stage that points or markers behind the encoder show.
LINK_SIDE_VISIBLE_EFFECTS = ("encoder_bias", "encoder_scale", "encoder_eccentricity", "backlash")
#: Effects that need the encoders' course in time.
MOTION_VISIBLE_EFFECTS = ("backlash", "link_flexibility")

Variant = tuple[str, int | None, str, tuple[float, ...]]


@dataclass(frozen=True, slots=True)
class Candidate:
    """One effect on one joint (1-based; None: the machine), in one variant: `fixed_parameters` do not move.

    `read_off`: the log itself shows its size, and nothing of it is fitted. `share_sample_count`: that size is a share,
    counted among so many; 0: it is not a share. `cycle_and_delay_s`: of a delay, a PLC's cycle and what the nominal
    machine has of it: whole cycles are where its cost has a kink that no gradient finds.
    """

    name: str
    joint: int | None
    stage: str
    variant_option: str
    parameter_slots: tuple[ParameterSlot, ...]
    fixed_parameters: tuple[tuple[ParameterSlot, float], ...] = ()
    share_sample_count: int = 0
    read_off: bool = False
    cycle_and_delay_s: tuple[float, float] | None = None

    def with_whole_delay(self, theta: Array) -> Array:
        """Numbers (slots,) with the delay at the nearest whole number of cycles."""
        if self.cycle_and_delay_s is None:
            return theta
        cycle_s, nominal_s = self.cycle_and_delay_s
        return np.round((theta + nominal_s) / cycle_s) * cycle_s - nominal_s

    @property
    def effect_and_joint(self) -> tuple[str, int | None]:
        """Effect and joint, whatever the variant."""
        return self.name, self.joint

    @property
    def without_variant(self) -> Variant:
        """The same with what distinguishes its variants: a length of a or of d, a tilt about x or about y."""
        return self.name, self.joint, self.variant_option, tuple(value for _, value in self.fixed_parameters)

    @property
    def has_narrow_minimum(self) -> bool:
        """Whether its valley is so narrow that a scanned size is better than where any slope leads."""
        return self.name in DENSE_SCAN_COUNT_BY_EFFECT

    @property
    def vector(self) -> bool:
        """Whether its numbers are the components of a direction."""
        return len(self.parameter_slots) > 1 and self.parameter_slots[0].parameter == self.parameter_slots[1].parameter

    def scan_points(self) -> Array:
        """Where the scan looks (m, slots)."""
        if self.vector:
            return _starts_around_zero(self.parameter_slots)  # a direction's vector: along each axis, both signs
        grids = [_slot_start_values(slot) for slot in self.parameter_slots]
        if self.fixed_parameters:  # many variants of one effect, each as strong as it is large
            grids[0] = grids[0][::2]
        return np.array(list(product(*grids)))


def in_words(name: str, joint: int | None) -> str:
    """An effect as it is read: its name, and the joint that it is on."""
    return name if joint is None else f"{name} {joint}"


def candidates_of(stage: Stage, joints: tuple[int, ...], machine: bool) -> tuple[Candidate, ...]:
    """Every candidate of a stage on these joints; with the machine's own where `machine`."""
    return tuple(candidate for effect in effects_of(stage) for candidate in _of_effect(effect, joints, machine))


def candidates_of_effects(names: tuple[str, ...], joints: tuple[int, ...]) -> tuple[Candidate, ...]:
    """Candidates of these effects."""
    return tuple(candidate for name in names for candidate in _of_effect(effect_of(name), joints, True))


def arm_candidates(joints: tuple[int, ...], moving: bool) -> tuple[Candidate, ...]:
    """What changes where a link is for its encoder. `moving`: whether the encoders' course in time is known, too."""
    found = candidates_of("structure", joints, True) + candidates_of_effects(LINK_SIDE_VISIBLE_EFFECTS, joints)
    return tuple(candidate for candidate in found if moving or candidate.name not in MOTION_VISIBLE_EFFECTS)


def on_an_arm(candidate: Candidate, torque_nm: float) -> Candidate:
    """The effect as an arm of this weight may have it: what bends by gravity bends as far, whatever its torque.

    Args: torque_nm: of all masses at the whole length. Arms as heavy as a crane's bend by what the catalogue says.
    """
    scale = max(1.0, CRANE_NM / torque_nm) if torque_nm > 0.0 else 1.0
    if candidate.name not in BENT_BY_GRAVITY or scale == 1.0:
        return candidate
    slots = (
        replace(
            slot,
            typical_max=scale * slot.typical_max,
            upper_bound=scale * slot.upper_bound,
            start_value=scale * slot.start_value,
            size_scale=scale,
        )
        for slot in candidate.parameter_slots
    )
    return replace(candidate, parameter_slots=tuple(slots))


def _of_effect(effect: Effect, joints: tuple[int, ...], machine: bool) -> list[Candidate]:
    places: tuple[int | None, ...] = joints
    if effect.scope == "machine":
        places = (None,) if machine else ()
    options = effect.quantity_choice.options if effect.quantity_choice else ("",)
    return [variant for joint in places for option in options for variant in _candidate_variants(effect, joint, option)]


def _candidate_variants(effect: Effect, joint: int | None, option: str) -> list[Candidate]:
    slots = slots_of(effect.name, joint, option)
    whole = {
        parameter.name: range(int(parameter.plausible_min), int(parameter.plausible_max) + 1)
        for parameter in effect.parameters
        if parameter.is_integer
    }
    if not whole:
        return [Candidate(effect.name, joint, effect.stage, option, slots)]
    moved = tuple(slot for slot in slots if slot.parameter not in whole)
    counted = [slot for slot in slots if slot.parameter in whole]
    values = product(*(whole[slot.parameter] for slot in counted))
    return [
        Candidate(effect.name, joint, effect.stage, option, moved, tuple(zip(counted, map(float, row), strict=True)))
        for row in values
    ]


def with_baseline_shapes(base: ParameterSets, candidates: tuple[Candidate, ...]) -> tuple[Candidate, ...]:
    """Candidates with the baseline's shape of the same effect: its oscillation's frequency, its wave's phase.

    Why: a shape replaces the baseline's, and a scan with every other one would first have to undo what is known. An
    oscillation keeps its frequency: a boom's depends on its reach, and a baseline tuned to another motion is not a new
    oscillation.
    """
    return tuple(_with_baseline_shape(base, candidate) for candidate in candidates)


def _with_baseline_shape(base: ParameterSets, candidate: Candidate) -> Candidate:
    size, *shape = candidate.parameter_slots
    if candidate.vector or not shape or base.get(size) == size.neutral_value:
        return candidate
    if candidate.name in OSCILLATION_EFFECTS:
        return replace(
            candidate, parameter_slots=(size,), fixed_parameters=tuple((slot, base.get(slot)) for slot in shape)
        )
    return replace(candidate, parameter_slots=(size, *(replace(slot, start_value=base.get(slot)) for slot in shape)))


def _slot_start_values(slot: ParameterSlot) -> Array:
    spec = slot.spec
    known = [slot.start_value] if slot.start_value != spec.start_value else []
    if slot.parameter == "phase_rad":
        return np.array([*SCAN_PHASES_RAD, *known])
    if slot.parameter == "frequency_hz":
        return np.array([*SCAN_FREQUENCIES_HZ, *known])
    if spec.role != "size":
        return np.array([slot.start_value])
    if slot.lower_bound > 0.0 and slot.neutral_value == 0.0:  # read off the data
        return np.array([slot.start_value])
    if slot.neutral_value != 0.0:
        return np.geomspace(max(slot.lower_bound, 1e-6), slot.typical_max, LIMIT_SCAN_COUNT)
    above = slot.typical_max * np.array(SCAN_SIZE_FRACS)
    if slot.effect in DENSE_SCAN_COUNT_BY_EFFECT:
        above = np.concatenate(
            [above[:2], np.linspace(0.0, slot.typical_max, DENSE_SCAN_COUNT_BY_EFFECT[slot.effect] + 1)[1:]]
        )
    if slot.upper_bound > slot.typical_max:
        above = np.append(above, np.linspace(slot.typical_max, slot.upper_bound, EXTENDED_SCAN_COUNT + 1)[:-1])
    return np.concatenate([slot.lower_bound * np.array(SCAN_SIZE_FRACS), above]) if slot.lower_bound < 0.0 else above


def _starts_around_zero(slots: tuple[ParameterSlot, ...]) -> Array:
    sizes = np.array([slot.typical_max for slot in slots]) * np.eye(len(slots))
    return np.concatenate([share * sign * sizes for share in (0.02, 0.1) for sign in (1.0, -1.0)])


def parameter_sets_with(base: ParameterSets, candidates: tuple[Candidate, ...], thetas: Array) -> ParameterSets:
    """`base` (one set) with these effects on top of it, once for each row of thetas (m, slots of all candidates).

    Model: as `machine.effects.entries.pack_effects`: what is neutral at 0 adds up, limits take the smaller, shapes
    replace.
    """
    thetas = np.atleast_2d(thetas)
    sets = base.repeated_sets(len(thetas))
    column = 0
    for candidate in candidates:
        size = candidate.parameter_slots[0].parameter
        for slot, value in candidate.fixed_parameters:
            sets.put(slot, value)
        for slot in candidate.parameter_slots:
            values = thetas[:, column]
            column += 1
            if slot.parameter != size:
                sets.put(slot, values)
            elif slot.neutral_value == 0.0:
                sets.put(slot, base.get(slot) + values)
            else:
                sets.put(slot, np.minimum(base.get(slot), values))
    return sets
