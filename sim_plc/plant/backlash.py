"""Play: an output that follows its input only at the edges of a gap."""

from numba import njit


@njit(cache=True, error_model="numpy")
def play(output: float, value: float, half_width: float) -> float:
    """New output of the play operator; half_width = 0 is the identity.

    Model:   out <- min(max(out, in - b/2), in + b/2).
    """
    if output < value - half_width:
        return value - half_width
    if output > value + half_width:
        return value + half_width
    return output
