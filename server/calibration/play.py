"""Which flank of its backlash each joint rests on: -1 to 1, followed through every motion (play operator).

A side that is not known is given as the middle of its possible range: 0 is "anywhere", and the share 1 - |side| of half
the play's width, evenly, is left open. Only a travel of the whole width makes a side known.
"""

import numpy as np

from server.calibration.contracts import Array

UNKNOWN_BACKLASH_SIDE = 0.0


def play_sides(qs: Array, widths_rad: Array, start: Array) -> Array:
    """Side of every joint along a path.

    Model:   two play operators, begun at both ends of where the joint may be: a side grows by 2 dq / width and stays
             within -1 to 1; +1 after a way up, when what the encoder turns is half a width behind. The side is their
             mean. Joints without play stay at 0.
    Args:    qs: encoders (m, n) [rad] in order. widths_rad: about how wide each joint's play is (n,). start: sides
             before the first sample (n,), 0 where nothing is known.
    Returns: (m, n), -1 to 1.
    """
    sides = np.empty_like(qs)
    bounds, gain = _play_side_bounds(start, widths_rad), _side_change_per_rad(widths_rad)
    before = qs[0] if len(qs) else start
    for i, q in enumerate(qs):
        bounds = _bounds_after_motion(bounds, q - before, gain)
        sides[i], before = bounds.mean(axis=0), q
    return sides


class PlayFollower:
    """The sides by the encoders, sample by sample, for every motion: jobs, the local lever, and stops on the way.

    Args: widths_rad: about how wide each joint's play is (n,). gap_max_s: after a longer silence, or when the times
          run backwards, nothing is known any more: the motion in between was not seen.
    """

    def __init__(self, widths_rad: Array, gap_max_s: float = 0.25) -> None:
        widths, self._gap_max_s = np.array(widths_rad, dtype=np.float64), gap_max_s
        self._nothing_known, self._per_rad = (
            _play_side_bounds(np.full(len(widths), UNKNOWN_BACKLASH_SIDE), widths),
            _side_change_per_rad(widths),
        )
        self._bounds = self._nothing_known
        self._t_s, self._q = float("nan"), np.zeros(len(widths))

    @property
    def side_in_play(self) -> Array:
        """Where each joint rests in its play (n,), -1 to 1, 0 where that is not known."""
        return np.asarray(self._bounds.mean(axis=0), dtype=np.float64)

    def take_encoders(self, t_s: float, q: Array) -> None:
        """Take in the encoders (n,) [rad] at a time of their own clock [s]."""
        if not 0.0 <= t_s - self._t_s <= self._gap_max_s:
            self._bounds = self._nothing_known
        else:
            self._bounds = _bounds_after_motion(self._bounds, q - self._q, self._per_rad)
        self._t_s, self._q = t_s, np.array(q, dtype=np.float64)


def _play_side_bounds(side: Array, widths_rad: Array) -> Array:
    """Least and greatest side (2, n) that a given side leaves open."""
    middle, left = np.where(widths_rad > 0.0, side, 0.0), np.where(widths_rad > 0.0, 1.0 - np.abs(side), 0.0)
    return np.array([middle - left, middle + left])


def _side_change_per_rad(widths_rad: Array) -> Array:
    """How far a side goes by a turn of 1 rad (n,); 0 without play."""
    return np.divide(2.0, widths_rad, out=np.zeros_like(widths_rad), where=widths_rad > 0.0)


def _bounds_after_motion(bounds: Array, dq: Array, gain: Array) -> Array:
    return np.asarray(np.clip(bounds + gain * dq, -1.0, 1.0), dtype=np.float64)
