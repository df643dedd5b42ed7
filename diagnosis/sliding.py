"""Joints that slide: what is said of them in rad is in m. One table of units for findings, places, plots, answers."""

from collections.abc import Sequence
from typing import Any

#: Unit of a joint that turns: of one that slides. Its load is a force, so that its compliance is a length by it.
LINEAR_UNIT_BY_ANGULAR_UNIT = {"rad": "m", "rad/s": "m/s", "rad/(N m)": "m/N"}
SLIDING_JOINT_ANGLE_EFFECTS = ("joint_axis_tilt",)  # of a sliding joint's axis, an angle all the same
ANGLE_RESULT_KEYS = ("tilt_rad", "phase_rad")


def is_joint_sliding(sliding: Sequence[bool], j: int) -> bool:
    """Whether joint j (0-based) slides; one without an entry turns."""
    return j < len(sliding) and sliding[j]


def unit_of(unit: str, sliding: Sequence[bool], j: int) -> str:
    """The unit that a number of joint j (0-based) has, which is written in `unit` of joints that turn."""
    return LINEAR_UNIT_BY_ANGULAR_UNIT.get(unit, unit) if is_joint_sliding(sliding, j) else unit


def column_of(pattern: str, sliding: Sequence[bool], j: int) -> str:
    """The name of joint j's (0-based) column: `q_{j}_rad` is q_1_rad, or q_1_m of a joint that slides."""
    name = pattern.replace("{j}", str(j + 1))
    return name.replace("_rad", "_m") if is_joint_sliding(sliding, j) else name


def in_metres(answer: Any, sliding: tuple[bool, ...], joint: int | None = None) -> Any:
    """The same answer with units in m wherever the joint (1-based) that a table belongs to slides."""
    if isinstance(answer, list):
        return [in_metres(item, sliding, joint) for item in answer]
    if not isinstance(answer, dict):
        return answer
    own = None if answer.get("name") in SLIDING_JOINT_ANGLE_EFFECTS else answer.get("joint", joint)
    out = {key: value if key in ANGLE_RESULT_KEYS else in_metres(value, sliding, own) for key, value in answer.items()}
    if isinstance(own, int) and isinstance(unit := out.get("unit"), str):
        out["unit"] = unit_of(unit, sliding, own - 1)
    return out
