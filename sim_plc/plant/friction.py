"""LuGre friction: bristles that hold at rest, slip at the breakaway force, and weaken with speed (Stribeck)."""

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def lugre_step(
    z: float,
    v: float,
    coulomb: float,
    static: float,
    viscous: float,
    stribeck: float,
    stiffness: float,
    damping: float,
    dt: float,
) -> tuple[float, float]:
    """New bristle deflection and friction force.

    Model:   z' = v - s0 |v| z / G(v), G = Fc + (Fs - Fc) exp(-(v/vs)^2), F = s0 z + s1(v) z' + s2 v. The decay of z is
             implicit (stable at any speed); s1 fades with speed as G does, so that bristles damp while they stick.
    Args:    z: deflection [m or rad]. v: speed. coulomb, static: Fc, Fs. viscous: s2. stribeck: vs. stiffness: s0.
             damping: s1.
    Returns: z after dt, force against the motion.
    Source:  Canudas de Wit 1995, eqs 1-3.
    """
    if stiffness <= 0.0:
        return 0.0, viscous * v
    fading = np.exp(-((v / stribeck) ** 2))
    level = coulomb + (static - coulomb) * fading
    z_new = (z + dt * v) / (1.0 + dt * stiffness * abs(v) / level)
    rate = (z_new - z) / dt
    return z_new, stiffness * z_new + damping * fading * rate + viscous * v
