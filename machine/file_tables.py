"""Lists of tables of a machine file, taken out of its text and added to it; comments and all else stay as they are.

Every result is parsed and compared: a result that is not TOML, or changes the machine otherwise, is refused.
"""

import re
import tomllib
from collections.abc import Sequence
from typing import Any

from machine.effects.entries import entries_to_toml, parse_entries
from machine.errors import MachineFileError

EFFECT_TABLE_NAME = "effect"
TOML_KEY_PATTERN = r"""(?:[A-Za-z0-9_-]+|"[^"\n]*"|'[^'\n]*')"""
TOML_TABLE_HEADER_PATTERN = re.compile(
    rf"[ \t]*\[\[?[ \t]*({TOML_KEY_PATTERN})[ \t]*(?:\.[ \t]*{TOML_KEY_PATTERN}[ \t]*)*\]\]?[ \t]*(?:#.*)?$"
)
TOML_ASSIGNMENT_PATTERN = re.compile(rf"[ \t]*({TOML_KEY_PATTERN})[ \t]*=")
TABLE_LAYOUT_REMEDY = "write each of them as its own [[effect]] or [[remainder]] table, behind all other tables"


def without_lists(text: str, names: Sequence[str]) -> str:
    """A machine file's text without the lists of these names: `[[x]]` with its sub-tables, or `x = [...]` at the top.

    Raises: MachineFileError: it is not TOML, or cannot be split into tables.
    """
    before = _parse_toml(text)
    lines = text.removeprefix("\ufeff").replace("\r\n", "\n").split("\n")
    kept: list[str] = []
    at_top, dropped, k = True, False, 0
    while k < len(lines):
        header = TOML_TABLE_HEADER_PATTERN.match(lines[k])
        if header is not None:
            at_top, dropped = False, _unquoted_key(header[1]) in names
        assigned = TOML_ASSIGNMENT_PATTERN.match(lines[k]) if at_top else None
        if assigned is not None and _unquoted_key(assigned[1]) in names:
            k += _lines_of_value(lines[k:])
            continue
        kept += [] if dropped else [lines[k]]
        k += 1
    out = "\n".join(kept)
    _require_same(before, _parse_toml(out), names)
    return out


def with_room_for_effects(text: str) -> str:
    """A machine file's text to whose end `[[effect]]` tables can be added: a list in one value becomes such tables.

    Raises: MachineFileError: it is not TOML, or cannot be split into tables.
    """
    before = _parse_toml(text)
    headers = [found[1] for line in text.splitlines() if (found := TOML_TABLE_HEADER_PATTERN.match(line))]
    if EFFECT_TABLE_NAME not in before or EFFECT_TABLE_NAME in map(_unquoted_key, headers):
        return text
    joints = before.get("joint")
    entries = parse_entries(before[EFFECT_TABLE_NAME], len(joints) if isinstance(joints, list) else 0)
    return with_tables(without_lists(text, (EFFECT_TABLE_NAME,)), entries_to_toml(entries))


def with_tables(text: str, added: str) -> str:
    """A machine file's text with lists of tables added behind it.

    Raises: MachineFileError: the result is not TOML, or states something else than both.
    """
    out = text.rstrip() + "\n" + added
    before, more, after = _parse_toml(text), _parse_toml(added), _parse_toml(out)
    for name, tables in more.items():
        if after[name] != [*before.get(name, []), *tables]:
            raise MachineFileError(f"the machine file's {name} cannot be added to; {TABLE_LAYOUT_REMEDY}")
    _require_same(before, after, tuple(more))
    return out


def _parse_toml(text: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text.removeprefix("\ufeff"))
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise MachineFileError(f"the machine file would not be valid TOML: {error}; {TABLE_LAYOUT_REMEDY}") from error


def _require_same(before: dict[str, Any], after: dict[str, Any], names: Sequence[str]) -> None:
    for key in sorted((before.keys() | after.keys()) - set(names)):
        if before.get(key) != after.get(key):
            raise MachineFileError(f"the machine file's {key!r} would be changed; {TABLE_LAYOUT_REMEDY}")


def _unquoted_key(key: str) -> str:
    return key.strip("\"'")


def _lines_of_value(lines: list[str]) -> int:
    """How many lines an assignment takes: as many as TOML needs."""
    for count in range(1, len(lines) + 1):
        try:
            tomllib.loads("\n".join(lines[:count]))
        except tomllib.TOMLDecodeError:
            continue
        return count
    return 1
