"""Which way the tool goes when a joint turns, in the words of somebody who stands behind the machine. Pure.

Seen by a person at the column who looks outward along the boom: out and in along the boom's horizontal direction, left
and right across it, up and down. A joint that only turns the tool is told by its turn, looking the way the tool looks.
"""

from dataclasses import dataclass

import numpy as np

from machine.chain import Chain
from machine.kinematics import link_poses, tcp_pose
from machine.rotations import Array

OPPOSITES = {"out": "in", "left": "right", "up": "down", "clockwise": "counter-clockwise"}
_OPPOSITE = OPPOSITES | {value: key for key, value in OPPOSITES.items()}
_SHORT = {"cw": "clockwise", "ccw": "counter-clockwise", "l": "left", "r": "right", "u": "up", "d": "down"}
_VISIBLE_M = 0.008  # a smaller motion of the tip is not seen from the column
_SIDE_SHARE = 0.5  # of the largest component: a person may name this one as well


@dataclass(frozen=True, slots=True)
class Expected:
    """What a person should see: the words that are right, the largest first, and a sentence for the report."""

    words: tuple[str, ...]
    text: str


def outward(T_base_tcp: Array) -> Array:
    """Axes of the person behind the machine in base (3, 3): rows: out, left, up; out is x above the column."""
    across = T_base_tcp[:2, 3]
    length = float(np.linalg.norm(across))
    out = np.array([across[0] / length, across[1] / length, 0.0]) if length > 1e-6 else np.array([1.0, 0.0, 0.0])
    up = np.array([0.0, 0.0, 1.0])
    return np.array([out, np.cross(up, out), up])


def expected_motion(chain: Chain, q: Array, joint: int, step_rad: float) -> Expected:
    """What the tool does when one joint turns by a step, by the machine's geometry.

    Args:    q: joints now (n,) [rad]; joint: index; step_rad: signed [rad].
    """
    after = q.copy()
    after[joint] += step_rad
    T_before, T_after = tcp_pose(chain, q), tcp_pose(chain, after)
    seen = outward(T_before) @ (T_after[:3, 3] - T_before[:3, 3])
    if float(np.abs(seen).max()) < _VISIBLE_M:
        return _turn(chain, q, joint, step_rad, T_before)
    names = (("out", "in"), ("left", "right"), ("up", "down"))
    order = np.argsort(-np.abs(seen))
    large = [i for i in order if abs(seen[i]) >= _SIDE_SHARE * abs(seen[order[0]])]
    words = tuple(names[i][0 if seen[i] > 0.0 else 1] for i in large)
    millimetres = ", ".join(f"{1e3 * abs(seen[i]):.0f} mm {names[i][0 if seen[i] > 0.0 else 1]}" for i in large)
    return Expected(words, f"tool tip goes {millimetres}")


def _turn(chain: Chain, q: Array, joint: int, step_rad: float, T_base_tcp: Array) -> Expected:
    axis = link_poses(chain, q)[joint][:3, 2] * np.sign(step_rad)
    looking = -T_base_tcp[:3, 2]  # the tool looks along -z_tcp
    word = "clockwise" if float(axis @ looking) > 0.0 else "counter-clockwise"
    turn = f"{abs(np.rad2deg(step_rad)):.1f} deg"
    return Expected((word,), f"tool turns {turn} {word}, seen from behind it, looking the way it looks")


def understood(answer: str) -> str | None:
    """The word that a person meant, or None."""
    word = answer.strip().lower()
    word = _SHORT.get(word, word)
    return word if word in _OPPOSITE else None


def compare(expected: Expected, word: str) -> bool | None:
    """Whether a seen word fits: True, False (it is the opposite of one), or None: neither."""
    if word in expected.words:
        return True
    return False if any(_OPPOSITE[right] == word for right in expected.words) else None
