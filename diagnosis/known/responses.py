"""How a machine still answers to its commands a while later, as families of functions: a linear form with a memory.

A velocity actuator follows at once but for its valve; oil, friction and booms do not. What they add is a response of
this joint's and of the other joints' commands: echoes after some delays, slow catching-up, swings. Each family is a
bank of fixed poles or delays, so that only its amounts are to be known.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from diagnosis.known.courses import Course, hats
from machine.rotations import Array

ECHOES_S = np.arange(1, 21) * 0.05
LAGS_S = (0.03, 0.1, 0.3, 1.0, 3.0)
LAG_KNOTS = np.array([-1.0, -0.25, -0.06, 0.0, 0.06, 0.25, 1.0])  # of full command
SWINGS_HZ = np.geomspace(0.5, 8.0, 9)
DAMPING = 0.25  # wide enough that a swing between two of the frequencies is a sum of both
RESPONSES = ("echoes", "catching up", "swings", "uneven swings", "the other joints' swings")


def responses(c: Course) -> dict[str, Array]:
    """Of one joint's actuator through a stretch: families (m, k)."""
    u, others = c.drive, list(c.others.T)
    of_others = [_swings(c, one) for one in others] or [np.zeros((len(u), 0))]
    families = (
        np.stack([np.interp(c.t_s - late_s, c.t_s, u) for late_s in ECHOES_S], axis=1),
        np.concatenate([c.leaking(hats(u, LAG_KNOTS), tau_s) for tau_s in LAGS_S], axis=1),
        _swings(c, u),
        _swings(c, u * np.abs(u)),
        np.concatenate(of_others, axis=1),
    )
    return dict(zip(RESPONSES, families, strict=True))


def _swings(c: Course, x: Array) -> Array:
    """What a signal (m,) sets swinging: both quadratures at each frequency (m, 2 frequencies)."""
    omega = 2.0 * np.pi * SWINGS_HZ
    poles = omega * (-DAMPING + 1j * np.sqrt(1.0 - DAMPING**2))
    kept = np.exp(poles * c.dt_s)
    rung = _rung(np.ascontiguousarray(x), kept, (kept - 1.0) / poles)
    return np.concatenate([rung.real, rung.imag], axis=1)


@njit(cache=True)
def _rung(x: Array, kept: NDArray[np.complex128], taken: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """z_k = kept z_(k-1) + taken x_(k-1) (m, poles), complex: dz/dt = s z + x with x held, exact at any step."""
    out = np.zeros((len(x), len(kept)), dtype=np.complex128)
    for i in range(1, len(x)):
        for k in range(len(kept)):
            out[i, k] = kept[k] * out[i - 1, k] + taken[k] * x[i - 1]
    return out
