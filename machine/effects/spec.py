"""An effect: its parameters with bounds, unit, neutral and prior, and what distinguishes it from its neighbours."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

Stage = Literal["time", "link", "controller", "actuator", "joint", "structure", "camera"]
STAGES: tuple[Stage, ...] = ("time", "link", "controller", "actuator", "joint", "structure", "camera")
Scope = Literal["joint", "machine"]
PriorKind = Literal["half_normal", "normal", "log_uniform", "uniform"]


@dataclass(frozen=True, slots=True)
class Prior:
    """How likely a size is before any data: `scale` is the standard deviation of the normal kinds."""

    kind: PriorKind
    scale: float = 0.0


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number of an effect. Role "size": at `neutral_value` the effect vanishes exactly; "shape": only says how it
    looks.

    `start_value`: where a fit begins, never at neutral, where thresholds have no slope.
    `plausible_min`..`plausible_max`: a fit that ends there means "larger than assumed". `poor_machine_max`: how far
    beyond it a poor machine's size may lie; `plausible_max` is then what good ones have, and the ruler of steps and
    scans. `light_arm_max`: what arms far lighter than a crane may have, and machine files hold; a fit's bounds go with
    the arm's weight (see `ParameterSlot.size_scale`). `open_frac`, `open_size`: by how much a size depends on what the
    effect's definition leaves open, in proportion and at least.
    """

    name: str
    unit: str
    plausible_min: float
    plausible_max: float
    start_value: float
    prior: Prior
    meaning: str
    neutral_value: float = 0.0
    role: Literal["size", "shape"] = "size"
    is_integer: bool = False
    poor_machine_max: float | None = None
    light_arm_max: float | None = None
    open_frac: float = 0.0
    open_size: float = 0.0

    @property
    def highest_value(self) -> float:
        """The largest value that is believed at all."""
        return self.plausible_max if self.poor_machine_max is None else self.poor_machine_max

    @property
    def max_admitted(self) -> float:
        """The largest value that a machine file may hold."""
        return self.highest_value if self.light_arm_max is None else self.light_arm_max

    def in_bounds(self, value: float) -> bool:
        """Whether a value lies inside the bounds; a size may also be neutral."""
        inside = self.plausible_min <= value <= self.max_admitted and (not self.is_integer or value == round(value))
        return inside or (self.role == "size" and value == self.neutral_value)

    def draw_value(self, rng: np.random.Generator) -> float:
        """A value from the prior, inside the bounds."""
        if self.prior.kind == "log_uniform":
            value = math.exp(rng.uniform(math.log(self.plausible_min), math.log(self.plausible_max)))
        elif self.prior.kind == "uniform":
            value = float(rng.uniform(self.plausible_min, self.plausible_max))
        else:
            drawn = float(rng.normal(0.0, self.prior.scale))
            value = min(
                max(abs(drawn) if self.prior.kind == "half_normal" else drawn, self.plausible_min), self.plausible_max
            )
        return float(round(value)) if self.is_integer else value


@dataclass(frozen=True, slots=True)
class QuantityChoice:
    """A word that says which of two quantities the size belongs to (a or d; about x or y)."""

    name: str
    options: tuple[str, ...]
    meaning: str


@dataclass(frozen=True, slots=True)
class Direction:
    """The unit vector that a size is measured along or about. In a fit size and direction are one plain vector.

    `n_fitted_components`: how many of its components, from the first, a fit moves; the others are another effect's.
    """

    name: str
    default_vector: tuple[float, ...]
    reference_frame: str
    n_fitted_components: int = 3


@dataclass(frozen=True, slots=True)
class Effect:
    """One entry of the catalogue. `looks_like`, `distinguished_by`: for the report; `source`: where it comes from.

    `prior_probability`: how likely a machine that no one has measured has it (at one joint), before any data.
    `has_threshold`: small sizes change nothing until a motion exceeds them, so that there is no slope at neutral.
    """

    name: str
    stage: Stage
    scope: Scope
    parameters: tuple[Parameter, ...]
    looks_like: str
    distinguished_by: str
    source: str
    quantity_choice: QuantityChoice | None = None
    direction: Direction | None = None
    prior_probability: float = 0.1
    has_threshold: bool = False

    def parameter(self, name: str) -> Parameter | None:
        """The parameter of this name; None if there is none."""
        return next((parameter for parameter in self.parameters if parameter.name == name), None)

    @property
    def size(self) -> Parameter:
        """The parameter that makes the effect vanish at neutral."""
        return next(parameter for parameter in self.parameters if parameter.role == "size")

    @property
    def shapes(self) -> tuple[Parameter, ...]:
        """The parameters that mean nothing while the size is neutral."""
        return tuple(parameter for parameter in self.parameters if parameter.role == "shape")
