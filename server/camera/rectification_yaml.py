"""YAML of calibration files: trees of text, and numbers out of them with errors that name the field. Pure."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
import yaml

from machine.rotations import Array
from server.camera.rectification_rig import CalibrationFileError

TEXT_MAX_CHARS = 1_000_000


@dataclass(frozen=True, slots=True)
class Fields:
    """What a file, or a part of it, holds by name; every reader raises CalibrationFileError with the file's name."""

    file: str
    tree: Mapping[str, object]

    def __contains__(self, key: str) -> bool:
        return key in self.tree

    def refusal(self, text: str) -> CalibrationFileError:
        """The error for something in this file."""
        return CalibrationFileError(f"{self.file}: {text}")

    def of_any(self, names: Sequence[str]) -> str | None:
        """The first of these names that is there."""
        return next((name for name in names if name in self), None)

    def value(self, key: str) -> object:
        """A field as it is."""
        if key not in self:
            raise self.refusal(f"field {key} is missing; it has {', '.join(sorted(map(str, self.tree))[:12])}")
        return self.tree[key]

    def nested_fields(self, key: str) -> "Fields":
        """A field that holds fields."""
        value = self.value(key)
        if not isinstance(value, dict):
            raise self.refusal(f"{key} = {str(value)[:40]!r} holds no fields")
        return Fields(f"{self.file}: {key}", cast("Mapping[str, object]", value))

    def numbers(self, key: str) -> Array:
        """All numbers of a field in order (n,): a list, a list of lists, or a matrix with rows, cols and data."""
        value, declared = self.value(key), None
        if isinstance(value, dict):
            part = self.nested_fields(key)
            declared = (
                part.whole_number("rows") * part.whole_number("cols") if "rows" in part and "cols" in part else None
            )
            value = part.value("data")
        found = np.array([self._finite_number(leaf, key) for leaf in _flatten_nested_list(value)], dtype=float)
        if declared is not None and declared != len(found):
            raise self.refusal(f"{key} has {len(found)} numbers, its rows x cols say {declared}")
        return found

    def matrix(self, key: str, shape: tuple[int, int]) -> Array:
        """A matrix of a given shape."""
        found = self.numbers(key)
        if len(found) != shape[0] * shape[1]:
            raise self.refusal(f"{key} has {len(found)} numbers; give {shape[0]} x {shape[1]}")
        return found.reshape(shape)

    def whole_number(self, key: str) -> int:
        """A whole number above 0 and below a million."""
        value = self.value(key)
        number = self._finite_number(value, key)
        if number != int(number) or not 0 < number < 1_000_000:
            raise self.refusal(f"{key} = {str(value)[:40]!r} is not a whole number above 0")
        return int(number)

    def lower_text(self, key: str) -> str:
        """A field of text, in small letters."""
        value = self.value(key)
        if not isinstance(value, str):
            raise self.refusal(f"{key} is not a word")
        return value.strip().lower()

    def _finite_number(self, value: object, key: str) -> float:
        try:
            number = float(value) if isinstance(value, str) else float("nan")
        except ValueError:
            number = float("nan")
        if not np.isfinite(number):
            raise self.refusal(f"{key}: {str(value)[:40]!r} is not a finite number")
        return number


def _flatten_nested_list(value: object) -> list[object]:
    if not isinstance(value, list):
        return [value]
    return [leaf for part in cast("Sequence[object]", value) for leaf in _flatten_nested_list(part)]


def parse_yaml(text: str, file: str) -> Fields:
    """The fields at a YAML text's top; every leaf is text. OpenCV's head line and matrix tags are understood.

    Raises: CalibrationFileError: not YAML, or no fields.
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
    return Fields(file, cast("Mapping[str, object]", tree))
