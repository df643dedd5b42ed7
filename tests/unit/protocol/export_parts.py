"""One export for all tests of the exporter, and a reader for the constants in it."""

import re
import struct
from functools import cache

from longreach.export_command import plc_parameters, st_sources
from protocol.twincat.bundle import build_bundle_files
from server.settings import read_machine

MACHINE = read_machine("hiab033")
PARAMETERS = plc_parameters(MACHINE, "10.1.2.3.1.1", "10.1.2.4.1.1")
_DECLARATION = re.compile(r"<Declaration><!\[CDATA\[(.*?)\]\]></Declaration>", re.DOTALL)
_CONSTANT = re.compile(r"^\s+(\w+)\s*:\s*(.+?)\s*:=\s*(.+?);", re.MULTILINE)


@cache
def exported() -> dict[str, bytes]:
    return build_bundle_files(PARAMETERS, st_sources())


def declaration(path: str) -> str:
    """The first declaration in a TwinCAT file."""
    found = _DECLARATION.search(exported()[f"twincat/{path}"].decode())
    assert found is not None
    return found.group(1)


def constants(name: str) -> dict[str, tuple[str, int | float | list[float]]]:
    """Type and value of every constant of a variable list, read as an ST compiler reads them."""
    rows = _CONSTANT.findall(declaration(f"GVLs/{name}.TcGVL"))
    return {row[0]: (row[1], _value(row[1], row[2])) for row in rows}


def _value(iec: str, text: str) -> int | float | list[float]:
    if text.startswith("["):
        return [_real(part) for part in text.strip("[]").split(",")]
    if iec == "REAL":
        return struct.unpack("<f", struct.pack("<f", _real(text)))[0]
    if iec == "LREAL":
        return _real(text)
    return int(text.removeprefix("16#"), 16) if text.startswith("16#") else int(text)


def _real(text: str) -> float:
    """ST wants digits on both sides of the point."""
    assert re.fullmatch(r"-?\d+\.\d+(E[+-]?\d+)?", text.strip()), text
    return float(text)
