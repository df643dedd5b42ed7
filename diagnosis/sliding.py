"""Joints that slide: what an answer says of them in rad is in m."""

from typing import Any

METRES = {"rad": "m", "rad/s": "m/s"}
TILTS = ("joint_axis_tilt",)  # of a sliding joint's axis, an angle all the same
ANGLES = ("tilt_rad", "phase_rad")


def in_metres(told: Any, sliding: tuple[bool, ...], joint: int | None = None) -> Any:
    """The same answer with units in m wherever the joint (1-based) that a table belongs to slides."""
    if isinstance(told, list):
        return [in_metres(one, sliding, joint) for one in told]
    if not isinstance(told, dict):
        return told
    own = None if told.get("name") in TILTS else told.get("joint", joint)
    slides = isinstance(own, int) and sliding[own - 1]
    out = {key: value if key in ANGLES else in_metres(value, sliding, own) for key, value in told.items()}
    if slides and isinstance(unit := out.get("unit"), str):
        out["unit"] = METRES.get(unit, unit)
    return out
