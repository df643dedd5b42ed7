"""Markers, boards and tracked points of a machine file, as far as it goes."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from diagnosis.errors import DiagnosisError
from diagnosis.log.machine_numbers import list_of, number_of, pose_of, table_of, vector_of
from machine.description import board_of, grid_markers
from machine.marker_sections import MARKER_FIELD_REMEDIES, BoardSection, check_ids
from machine.targets import Marker


@dataclass(frozen=True, slots=True)
class TrackedPoint:
    """A point fixed to link `joint` (0: the base), in that link's frame (3,) [m]; None: to be found from the data."""

    name: str
    joint: int
    xyz_m: tuple[float, float, float] | None


def markers_of(tables: Mapping[str, Any]) -> tuple[Marker, ...]:
    """The single markers, and every marker of the grids, which are markers like all others.

    Raises: DiagnosisError: a field that is missing or wrong. MachineError: ids that repeat, or an impossible board.
    """
    section = table_of(tables.get("markers", {}), "[markers]")
    singles = [
        _parse_marker(section, f"markers.marker {k}") for k, section in enumerate(list_of(section, "marker"), start=1)
    ]
    boards = [
        _parse_board(section, f"markers.board {k}") for k, section in enumerate(list_of(section, "board"), start=1)
    ]
    check_ids([single.marker_id for single in singles], boards, str(section.get("dictionary", "")))
    return (*singles, *grid_markers(tuple(board_of(board) for board in boards)))


def _parse_marker(section: object, where: str) -> Marker:
    table = table_of(section, where)
    side, T, on = number_of(table, "side_m", where), pose_of(table, "T_on_marker", where), table.get("on")
    marker_id = table.get("id")
    if side is None or T is None or on not in ("tool", "ooi") or not _is_count(marker_id):
        raise DiagnosisError(f"machine.toml: {where} needs id, side_m, on ('tool' or 'ooi') and T_on_marker")
    return Marker(table["id"], side, on, T)


def _parse_board(section: object, where: str) -> BoardSection:
    table = table_of(section, where)
    known = {key: value for key, value in table.items() if key in BoardSection.model_fields}
    try:
        return BoardSection.model_validate(known)
    except ValidationError as error:
        first = error.errors()[0]
        field = str(first["loc"][0]) if first["loc"] else "board"
        given = "" if first["type"] == "missing" else f" = {table.get(field)!r}"
        raise DiagnosisError(
            f"machine.toml: {where}: {field}{given}: {first['msg']}; {MARKER_FIELD_REMEDIES.get(field, 'correct it')}"
        ) from error


def _is_count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def points_of(tables: Mapping[str, Any], n: int) -> tuple[TrackedPoint, ...]:
    """The tracked points on an arm of n joints. Raises: DiagnosisError: a field that is missing or wrong."""
    found = []
    for name, point in table_of(tables.get("points", {}), "[points]").items():
        table = table_of(point, f"points.{name}")
        joint, xyz = table.get("joint"), vector_of(table, "xyz_m", 3, f"points.{name}")
        if isinstance(joint, bool) or not isinstance(joint, int) or not 0 <= joint <= n:
            raise DiagnosisError(f"machine.toml: points.{name} needs joint = 0 .. {n}, and xyz_m = [x, y, z] if known")
        at = None if xyz is None else (float(xyz[0]), float(xyz[1]), float(xyz[2]))
        found.append(TrackedPoint(name, joint, at))
    return tuple(found)
