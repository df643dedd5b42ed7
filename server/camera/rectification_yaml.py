"""YAML of calibration files as trees of text, and numbers out of them with errors that name the field. Pure."""

from collections.abc import Mapping, Sequence
from typing import cast

import numpy as np
import yaml

from machine.rotations import Array
from server.camera.rectification_rig import CalibrationFileError

Tree = Mapping[str, object]
TEXT_MAX_CHARS = 1_000_000


def parse_yaml(text: str, file: str) -> Tree:
    """The mapping at a YAML text's top; every leaf is text. OpenCV's head line and matrix tags are understood.

    Raises: CalibrationFileError: not YAML, or no mapping.
    """
    if len(text) > TEXT_MAX_CHARS:
        raise CalibrationFileError(f"{file}: {len(text)} characters (limit {TEXT_MAX_CHARS}); not a calibration file")
    lines = text.lstrip("\ufeff").splitlines()
    if lines and lines[0].startswith("%YAML"):
        lines = lines[1:]  # OpenCV writes %YAML:1.0, which YAML itself does not know
    try:
        tree = yaml.load("\n".join(lines), Loader=yaml.BaseLoader)  # makes text, lists and maps only
    except (yaml.YAMLError, RecursionError) as error:
        reason = " ".join(str(error).split())[:160]
        raise CalibrationFileError(f"{file}: not a calibration file in YAML ({reason})") from error
    if not isinstance(tree, dict):
        raise CalibrationFileError(f"{file}: no fields at its top level; give a calibration file")
    return cast("Tree", tree)


def child(tree: Tree, key: str, file: str) -> object:
    """A field.

    Raises: CalibrationFileError: it is missing.
    """
    if key not in tree:
        raise CalibrationFileError(f"{file}: field {key} is missing; it has {', '.join(sorted(map(str, tree))[:12])}")
    return tree[key]


def mapping(tree: Tree, key: str, file: str) -> Tree:
    """A field that holds fields."""
    value = child(tree, key, file)
    if not isinstance(value, dict):
        raise CalibrationFileError(f"{file}: {key} = {str(value)[:40]!r} holds no fields")
    return cast("Tree", value)


def numbers(tree: Tree, key: str, file: str) -> Array:
    """All numbers of a field in order (n,): a list, a list of lists, or a matrix with rows, cols and data.

    Raises: CalibrationFileError: missing, not numbers, or a matrix whose data do not fill it.
    """
    value = child(tree, key, file)
    declared: int | None = None
    if isinstance(value, dict):
        part = cast("Tree", value)
        if "rows" in part and "cols" in part:
            declared = whole(part, "rows", f"{file}: {key}") * whole(part, "cols", f"{file}: {key}")
        value = child(part, "data", f"{file}: {key}")
    found = np.array([_number(leaf, f"{file}: {key}") for leaf in _leaves(value, f"{file}: {key}")], dtype=float)
    if declared is not None and declared != len(found):
        raise CalibrationFileError(f"{file}: {key} has {len(found)} numbers, its rows x cols say {declared}")
    return found


def matrix(tree: Tree, key: str, file: str, shape: tuple[int, int]) -> Array:
    """A matrix of a given shape."""
    found = numbers(tree, key, file)
    if len(found) != shape[0] * shape[1]:
        raise CalibrationFileError(f"{file}: {key} has {len(found)} numbers; give {shape[0]} x {shape[1]}")
    return found.reshape(shape)


def whole(tree: Tree, key: str, file: str) -> int:
    """A whole number above 0 and below a million."""
    value = child(tree, key, file)
    number = _number(value, f"{file}: {key}")
    if number != int(number) or not 0 < number < 1_000_000:
        raise CalibrationFileError(f"{file}: {key} = {str(value)[:40]!r} is not a whole number above 0")
    return int(number)


def text_of(tree: Tree, key: str, file: str) -> str:
    """A field of text, in small letters."""
    value = child(tree, key, file)
    if not isinstance(value, str):
        raise CalibrationFileError(f"{file}: {key} is not a word")
    return value.strip().lower()


def _leaves(value: object, subject: str) -> list[object]:
    if not isinstance(value, list):
        return [value]
    flat: list[object] = []
    for part in cast("Sequence[object]", value):
        flat += _leaves(part, subject) if isinstance(part, list) else [part]
    return flat


def _number(value: object, subject: str) -> float:
    try:
        number = float(value) if isinstance(value, str) else float("nan")
    except ValueError:
        number = float("nan")
    if not np.isfinite(number):
        raise CalibrationFileError(f"{subject}: {str(value)[:40]!r} is not a finite number")
    return number
