"""Whether a log's rows were taken as evenly as a machine runs, and only their stamps are uneven: the encoders show it.

Why: a PC that stamps the rows of a PLC does it a millisecond early or late. Signals brought to an even rate by such
     stamps are wrong by as much, where the machine goes fast; a healthy one was refused for it.
"""

import numpy as np

from machine.rotations import Array

# Of a step: a stamp farther from the even rate may be of a row that came after a missing one
STAMP_OFFSET_MAX_STEP_FRAC = 0.45
STAMP_FOLLOWING_MAX_FRAC = 0.5  # of the unevenness: rows that follow their stamps show all of it, even ones nothing
SEPARATION_SIGMAS_MIN = 4.0  # standard errors between the two
CUBIC_RESIDUAL_STENCIL = (
    1.0 / 6.0,
    -4.0 / 6.0,
    1.0,
    -4.0 / 6.0,
    1.0 / 6.0,
)  # a row less the cubic through the two on either side


def even_grid(t_s: Array) -> Array:
    """The even times (m,) nearest to stamps (m,)."""
    k = np.arange(len(t_s)) - 0.5 * (len(t_s) - 1)
    return t_s.mean() + k * float(k @ t_s) / float(k @ k)


def taken_evenly(enc: Array | None, t_s: Array, grid_s: Array) -> bool:
    """Whether encoders (m, n) stamped t_s (m,) moved as if their rows were at grid_s (m,); False where none shows it.

    Model: a row stands off the cubic through its four neighbours by speed times its stamp's unevenness against theirs,
           if the stamps are true, and by nothing of that if the rows were even: the share of it by least squares.
    """
    off, step_s = t_s - grid_s, float(grid_s[1] - grid_s[0])
    if (
        enc is None
        or len(t_s) <= len(CUBIC_RESIDUAL_STENCIL)
        or np.abs(off).max() > STAMP_OFFSET_MAX_STEP_FRAC * step_s
    ):
        return False
    expected = _off_cubic(off[:, None]) * (enc[3:-1] - enc[1:-3]) / (2.0 * step_s)
    stands = _off_cubic(enc)
    good = np.isfinite(expected) & np.isfinite(stands)
    x, y = expected[good], stands[good]
    power = float(x @ x)
    if power == 0.0:
        return False
    share = float(x @ y) / power
    error = float(np.sqrt(np.mean((y - share * x) ** 2) / power))
    return share < STAMP_FOLLOWING_MAX_FRAC and SEPARATION_SIGMAS_MIN * error < 1.0


def _off_cubic(values: Array) -> Array:
    """Each row (m - 4, n) less the cubic through its neighbours."""
    rows = len(values) - len(CUBIC_RESIDUAL_STENCIL) + 1
    return np.sum([share * values[k : k + rows] for k, share in enumerate(CUBIC_RESIDUAL_STENCIL)], axis=0)
