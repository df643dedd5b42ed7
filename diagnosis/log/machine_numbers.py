"""Numbers, vectors, poses and words of a machine file, each with the range that anything on earth has."""

import sys
from collections.abc import Mapping
from typing import Any

import numpy as np

from diagnosis.errors import DiagnosisError
from machine.rotations import Array

#: Lowest, highest, unit. Beyond them a unit, a sign or a digit is wrong; steps and memory would have no end.
RANGES: dict[str, tuple[float, float, str]] = {
    "velocity_gain_rad_s": (1e-6, 1e3, "rad/s"),
    "valve_frequency_hz": (1e-2, 1e3, "Hz"),
    "valve_damping": (1e-2, 10.0, ""),
    "kp_frac_per_rad": (0.0, 1e5, "1/rad"),
    "pt1_tau_s": (0.0, 100.0, "s"),
    "cycle_s": (1e-5, 1.0, "s"),
    "log_cycle_s": (1e-5, 10.0, "s"),
    "transport_delay_s": (0.0, 10.0, "s"),
    "mass_kg": (0.0, 1e6, "kg"),
    "com_m": (-100.0, 100.0, "m"),
    "a_m": (-100.0, 100.0, "m"),
    "d_m": (-100.0, 100.0, "m"),
    "alpha_deg": (-720.0, 720.0, "deg"),
    "theta_offset_deg": (-720.0, 720.0, "deg"),
    "gravity_base_m_s2": (-100.0, 100.0, "m/s^2"),
    "width_px": (1.0, 1e5, "px"),
    "height_px": (1.0, 1e5, "px"),
    "fx_px": (1.0, 1e6, "px"),
    "fy_px": (1.0, 1e6, "px"),
    "cx_px": (-1e6, 1e6, "px"),
    "cy_px": (-1e6, 1e6, "px"),
    "baseline_m": (1e-4, 100.0, "m"),
    "rate_hz": (0.0, 1e5, "Hz"),
    "distortion": (-1e4, 1e4, ""),
    "side_m": (1e-4, 100.0, "m"),
    "xyz_m": (-60.0, 60.0, "m"),
}
FLOAT_MAX = sys.float_info.max  # TOML's whole numbers have no end
DEFAULT_RANGE = (-1e9, 1e9, "")
POSE_DISTANCE_MAX_M = 1e3  # of a pose: a tracker may stand far away; millimetres taken for metres are farther
HOMOGENEOUS_BOTTOM_ROW = (0.0, 0.0, 0.0, 1.0)


def number_of(table: Mapping[str, Any], key: str, where: str) -> float | None:
    """A number inside its range; None where it is not given.

    Raises: DiagnosisError: no number, or outside what is possible; names field, value, limits and unit.
    """
    value = table.get(key)
    return None if value is None else _number_in_range(value, key, f"machine.toml: {where}: {key}")


def vector_of(table: Mapping[str, Any], key: str, size: int, where: str) -> Array | None:
    """So many numbers inside their range (size,); None where they are not given. Raises: as `number_of`."""
    value = table.get(key)
    if value is None:
        return None
    subject = f"machine.toml: {where}: {key}"
    if not isinstance(value, list) or len(value) != size:
        raise DiagnosisError(f"{subject} = {_shortened_repr(value)}; give {size} finite numbers")
    return np.array([_number_in_range(entry, key, f"{subject}[{k}]") for k, entry in enumerate(value)])


def pose_of(table: Mapping[str, Any], key: str, where: str) -> Array | None:
    """A pose (4, 4), written row by row; None where it is not given. Raises: as `number_of`; it is not a pose."""
    numbers = vector_of(table, key, 16, where)
    if numbers is None:
        return None
    T, subject = numbers.reshape(4, 4), f"machine.toml: {where}: {key}"
    if np.abs(T[3] - HOMOGENEOUS_BOTTOM_ROW).max() > 1e-9:
        raise DiagnosisError(f"{subject} ends with {T[3].tolist()}; write it row by row, the last row 0, 0, 0, 1")
    if np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max() > 1e-6 or np.linalg.det(T[:3, :3]) < 0.0:
        raise DiagnosisError(f"{subject} is not a pose; its rotation is not orthonormal to 1e-6")
    if np.abs(T[:3, 3]).max() > POSE_DISTANCE_MAX_M:
        raise DiagnosisError(
            f"{subject} lies {np.abs(T[:3, 3]).max():g} m away, limit {POSE_DISTANCE_MAX_M:g} m; write metres"
        )
    return T


def flag_of(table: Mapping[str, Any], key: str, where: str, otherwise: bool) -> bool:
    """true or false; `otherwise` where it is not given. Raises: DiagnosisError: text or a number in its place."""
    value = table.get(key, otherwise)
    if not isinstance(value, bool):
        raise DiagnosisError(
            f"machine.toml: {where}: {key} = {_shortened_repr(value)}; write true or false, without quotes"
        )
    return value


def is_sliding(joint: Mapping[str, Any], where: str) -> bool:
    """Whether a [[joint]] is written as sliding: by its type, without one it turns. Raises: DiagnosisError: another."""
    kind = joint.get("type", "revolute")
    if kind not in ("revolute", "prismatic"):
        raise DiagnosisError(f"machine.toml: {where}: type = {_shortened_repr(kind)}; give 'revolute' or 'prismatic'")
    return kind == "prismatic"


def table_of(value: Any, where: str) -> dict[str, Any]:
    """A section. Raises: DiagnosisError: something else stands in its place."""
    if not isinstance(value, dict):
        raise DiagnosisError(f"machine.toml: {where} = {_shortened_repr(value)} is not a table")
    return value


def list_of(table: Mapping[str, Any], key: str) -> list[Any]:
    """A list of sections. Raises: DiagnosisError: something else stands in its place."""
    value = table.get(key, [])
    if not isinstance(value, list):
        raise DiagnosisError(f"machine.toml: {key} is not a list; write [[{key}]]")
    return value


def _number_in_range(value: object, key: str, subject: str) -> float:
    low, high, unit = RANGES.get(key, DEFAULT_RANGE)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= FLOAT_MAX:
        raise DiagnosisError(f"{subject} = {_shortened_repr(value)} is not a finite number")
    if not low <= value <= high:
        raise DiagnosisError(
            f"{subject} = {float(value):g}, limits {low:g} to {high:g} {unit}".rstrip() + "; correct it"
        )
    return float(value)


def _shortened_repr(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
