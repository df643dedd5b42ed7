"""What the PLC's inputs tell in one cycle."""

from dataclasses import dataclass

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
