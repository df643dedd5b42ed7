"""The PLC's inputs of one cycle."""

import math
from dataclasses import dataclass, replace

from machine.rotations import Array


@dataclass(frozen=True, slots=True)
class PlantSample:
    """Encoders and pressures; arrays (n,), SI units, oil temperature [degC]."""

    q_rad: Array
    qd_rad_s: Array
    p_a_pa: Array
    p_b_pa: Array
    p_supply_pa: float
    t_oil_c: float
    p_tank_pa: float = 1e5


def with_finite_readings(sample: PlantSample) -> PlantSample:
    """The sample with 0 for a supply, tank or oil reading that is not finite; encoders stay as they are."""
    readings = (sample.p_supply_pa, sample.t_oil_c, sample.p_tank_pa)
    if all(map(math.isfinite, readings)):
        return sample
    supply, oil, tank = (x if math.isfinite(x) else 0.0 for x in readings)
    return replace(sample, p_supply_pa=supply, t_oil_c=oil, p_tank_pa=tank)
