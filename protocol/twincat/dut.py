"""Wire structs as TwinCAT types from the layout table, with the unions that access their bytes."""

from dataclasses import dataclass

from protocol import layout
from protocol.layout import AXES, Block, Field

_PACK = "{attribute 'pack_mode' := '1'}"


@dataclass(frozen=True, slots=True)
class Dut:
    """One data type: its name and its declaration."""

    name: str
    text: str


def duts() -> tuple[Dut, ...]:
    """Structs and unions of the wire, of the limits table, and of the machine's readings."""
    knots = f"    aKnots : ARRAY[0..{layout.KNOTS_PER_COMMAND - 1}] OF ST_HmKnot; // {layout.KNOTS_OFFSET}"
    command = [*_fields(layout.HEADER), *_fields(layout.COMMAND_BODY), knots, *_fields(layout.COMMAND_TAIL)]
    return (
        _struct("ST_HmKnot", "One point of the reference.", _fields(layout.KNOT)),
        _struct("ST_HmCmd", "PC to PLC; comments: byte offsets.", command),
        _struct("ST_HmState", "PLC to PC.", [*_fields(layout.HEADER), *_fields(layout.STATE_BODY)]),
        _struct("ST_HmLimits", "What cfg_id is the CRC-32 of; never sent.", _fields(layout.LIMITS)),
        _struct("ST_HmSample", "This machine's readings of one cycle: rad, rad/s, Pa, degC.", _SAMPLE),
        _union("U_HmCmd", "ST_HmCmd", layout.COMMAND_SIZE),
        _union("U_HmState", "ST_HmState", layout.STATE_SIZE),
        _union("U_HmLimits", "ST_HmLimits", layout.LIMITS.codec.size),
        _union("U_HmSample", "ST_HmSample", _SAMPLE_SIZE),
    )


_SAMPLE_SIZE = 2 * 8 * AXES + 2 * 4 * AXES + 16
_SAMPLE = [
    f"    aQ : ARRAY[0..{AXES - 1}] OF LREAL; // encoders",
    f"    aQd : ARRAY[0..{AXES - 1}] OF LREAL;",
    f"    aPa : ARRAY[0..{AXES - 1}] OF REAL; // chamber pressures",
    f"    aPb : ARRAY[0..{AXES - 1}] OF REAL;",
    "    fSupply : REAL;",
    "    fTank : REAL;",
    "    fOil : REAL;",
    "    fReserved : REAL; // fills up to 8 bytes",
]


def _fields(block: Block) -> list[str]:
    return [f"    {field.name} : {_type(field)}; // {field.offset}" for field in block.fields]


def _type(field: Field) -> str:
    if field.count == 1:
        return field.iec
    base = "BYTE" if field.iec == "USINT" else field.iec
    return f"ARRAY[0..{field.count - 1}] OF {base}"


def _struct(name: str, purpose: str, lines: list[str]) -> Dut:
    body = "\n".join(lines)
    return Dut(name, f"(* {purpose} *)\n{_PACK}\nTYPE {name} :\nSTRUCT\n{body}\nEND_STRUCT\nEND_TYPE\n")


def _union(name: str, struct: str, size: int) -> Dut:
    text = (
        f"(* {struct} (m), its bytes (b), and its words (w) for finite tests on bits. *)\nTYPE {name} :\nUNION\n"
        f"    m : {struct};\n    b : ARRAY[0..{size - 1}] OF BYTE;\n    w : ARRAY[0..{size // 8 - 1}] OF ULINT;\n"
        "END_UNION\nEND_TYPE\n"
    )
    return Dut(name, text)
