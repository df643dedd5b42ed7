"""Unit of a field from the suffix of its name, for messages and tables."""

# fmt: off
UNIT_BY_NAME_SUFFIX = {
    "_mm": "mm", "_m": "m", "_deg": "deg", "_rad": "rad", "_ms": "ms", "_s": "s", "_h": "h", "_hz": "Hz", "_k": "K",
    "_kg": "kg", "_px": "px", "_frac": "0..1", "_pct": "%", "_mm_s": "mm/s", "_m_s": "m/s", "_deg_s": "deg/s",
    "_rad_s": "rad/s", "_m_s2": "m/s^2", "_deg_s2": "deg/s^2", "_rad_s2": "rad/s^2", "_per_rad": "1/rad",
}
# fmt: on
_LONGEST_FIRST = sorted(UNIT_BY_NAME_SUFFIX, key=len, reverse=True)


def unit_of(field: str) -> str:
    """Its unit, or an empty text: `speed_max_mm_s` is in mm/s, whatever else it ends in."""
    return next((UNIT_BY_NAME_SUFFIX[ending] for ending in _LONGEST_FIRST if field.endswith(ending)), "")
