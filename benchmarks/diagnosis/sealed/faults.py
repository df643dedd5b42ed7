"""What is wrong with a plant: catalogue effects as their definitions say, and foreign ones that no catalogue holds."""

from dataclasses import dataclass, field

import numpy as np

from machine.rotations import Array

# Columns of `Faults.joint`, one row a joint; neutral values beside them
(
    STEP, RATE, KP_GAIN, KP_LAG, U_LIMIT, DEADBAND, LAG, HYSTERESIS, FLOW, ASYMMETRY, DROOP, LEAK, BREAKAWAY,
    SPOOL_RATE, WARMING, GEAR, GEAR_ORDER, TUG,
) = range(18)  # fmt: skip
COLUMNS = 18
NEUTRAL = {RATE: np.inf, U_LIMIT: 1.0, SPOOL_RATE: np.inf, GEAR_ORDER: 1.0}
_DYNAMIC = {
    "reference_quantisation": STEP,
    "reference_rate_limit": RATE,
    "controller_gain_error": KP_GAIN,
    "controller_lag_error": KP_LAG,
    "controller_saturation": U_LIMIT,
    "valve_deadband": DEADBAND,
    "valve_lag": LAG,
    "valve_hysteresis": HYSTERESIS,
    "flow_gain_error": FLOW,
    "valve_asymmetry": ASYMMETRY,
    "load_droop": DROOP,
    "internal_leakage": LEAK,
    "stiction": BREAKAWAY,
}
FOREIGN = (
    "spool_rate_limit",
    "thermal_gain_drift",
    "gear_eccentricity",
    "cable_tug",
    "dropped_samples",
    "swapped_joints",
    "loose_marker",
)


@dataclass(frozen=True)
class Injected:
    """One effect: catalogue name or foreign name, joint (1-based; None: the machine), its numbers by parameter."""

    name: str
    joint: int | None
    values: dict[str, float]
    option: str = ""
    direction: tuple[float, ...] = ()

    @property
    def size(self) -> float:
        """The first number."""
        return next(iter(self.values.values()))


@dataclass
class Faults:
    """Everything that is wrong, in the form that the simulation takes."""

    joint: Array
    flow_limit: float = np.inf
    delay_s: float = 0.0
    loss_frac: float = 0.0
    injected: tuple[Injected, ...] = ()
    extra: dict[str, Injected] = field(default_factory=dict)

    def of(self, name: str, joint: int | None = None) -> float:
        """The size of an effect that is no column; 0 without it."""
        return sum(one.size for one in self.injected if one.name == name and one.joint == joint)


def faults_of(injected: tuple[Injected, ...], n: int) -> Faults:
    """From a list of effects to the simulation's numbers.

    Raises: KeyError: a name that the simulation does not know.
    """
    joint = np.zeros((n, COLUMNS))
    for column, value in NEUTRAL.items():
        joint[:, column] = value
    out = Faults(joint, injected=injected)
    for one in injected:
        if one.name in _DYNAMIC:
            joint[_row(one), _DYNAMIC[one.name]] = one.size
        elif one.name == "transport_delay":
            out.delay_s = one.size
        elif one.name == "packet_loss":
            out.loss_frac = one.size
        elif one.name == "supply_droop":
            out.flow_limit = one.size
        elif one.name == "spool_rate_limit":
            joint[_row(one), SPOOL_RATE] = one.size
        elif one.name == "thermal_gain_drift":
            joint[_row(one), WARMING] = one.size
        elif one.name == "gear_eccentricity":
            joint[_row(one), GEAR], joint[_row(one), GEAR_ORDER] = one.size, one.values["order"]
        elif one.name == "cable_tug":
            joint[_row(one), TUG] = one.size
    return out


def _row(one: Injected) -> int:
    if one.joint is None:
        raise KeyError(f"{one.name} belongs to a joint")
    return one.joint - 1
