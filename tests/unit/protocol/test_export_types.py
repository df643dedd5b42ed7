"""The exported types and constants against the tables, read back from the ST text by other code than wrote it."""

import re
import struct
import zlib
from enum import IntEnum

import pytest
from export_parts import PARAMETERS, constants, declaration

from protocol import codes, layout, timeouts
from protocol.codes import PlcState
from protocol.limits import cfg_id
from protocol.plc_events import PlcAction
from protocol.plc_states import TRANSITIONS, PlcEvent
from protocol.twincat.bundle import next_state_source

SIZES = {"BYTE": 1, "USINT": 1, "UINT": 2, "UDINT": 4, "REAL": 4, "ULINT": 8, "LREAL": 8}
MEMBER = re.compile(r"^\s+(\w+)\s*:\s*(?:ARRAY\[0\.\.(\d+)\] OF )?(\w+);(?:\s*//\s*(\d+)\s*$)?", re.MULTILINE)


def members(name: str) -> list[tuple[str, int, int, str]]:
    """Name, size of one element, number of elements, and the offset that the comment claims."""
    found = MEMBER.findall(declaration(f"DUTs/{name}.TcDUT"))
    assert found
    return [(row[0], size_of(row[2]), int(row[1] or 0) + 1, row[3]) for row in found]


def size_of(iec: str) -> int:
    return SIZES[iec] if iec in SIZES else place(iec)[1]


def place(name: str) -> tuple[dict[str, int], int]:
    """Offsets and size with natural alignment; a struct of structs is aligned to 8 here."""
    offsets, at, widest = {}, 0, 1
    for field, size, count, claimed in members(name):
        align = min(size, 8)
        widest = max(widest, align)
        at = -(-at // align) * align
        assert claimed in ("", str(at)), field
        offsets[field] = at
        at += size * count
    return offsets, -(-at // widest) * widest


@pytest.mark.parametrize(
    ("name", "size", "blocks"),
    [
        ("ST_HmCmd", 1304, (layout.HEADER_LAYOUT, layout.COMMAND_BODY_LAYOUT, layout.COMMAND_TAIL_LAYOUT)),
        ("ST_HmKnot", 200, (layout.KNOT_LAYOUT,)),
        ("ST_HmState", 568, (layout.HEADER_LAYOUT, layout.STATE_BODY_LAYOUT)),
        ("ST_HmLimits", 288, (layout.LIMIT_TABLE_LAYOUT,)),
    ],
)
def test_every_field_lies_where_the_table_says_with_and_without_alignment(name, size, blocks):
    offsets, aligned_size = place(name)
    expected = {field.name: field.offset for block in blocks for field in block.fields}
    if name == "ST_HmCmd":
        expected["aKnots"] = 80
    assert offsets == expected
    assert aligned_size == size == sum(element * count for _, element, count, _ in members(name))


@pytest.mark.parametrize("name", ["ST_HmCmd", "ST_HmKnot", "ST_HmState", "ST_HmLimits", "ST_HmSample"])
def test_every_struct_is_packed_by_its_own_attribute(name):
    assert "\n{attribute 'pack_mode' := '1'}\nTYPE " + name in declaration(f"DUTs/{name}.TcDUT")


@pytest.mark.parametrize("kind", ["Cmd", "State", "Limits", "Sample"])
def test_unions_cover_their_struct_with_bytes_and_words(kind):
    union, struct_name = f"U_Hm{kind}", f"ST_Hm{kind}"
    found = {row[0]: (row[2], int(row[1] or 0) + 1) for row in MEMBER.findall(declaration(f"DUTs/{union}.TcDUT"))}
    size = place(struct_name)[1]
    assert found == {"m": (struct_name, 1), "b": ("BYTE", size), "w": ("ULINT", size // 8)}
    assert size % 8 == 0


@pytest.mark.parametrize(
    ("name", "base", "kind"),
    [
        ("E_HmMsgType", "USINT", codes.MessageType),
        ("E_HmMode", "UINT", codes.Mode),
        ("E_HmPlcState", "USINT", codes.PlcState),
        ("E_HmLinkState", "USINT", codes.LinkState),
        ("E_HmInterp", "USINT", codes.Interp),
        ("E_HmReject", "UINT", codes.RejectCode),
    ],
)
def test_wire_enumerations_have_their_numbers_and_base_type(name: str, base: str, kind: type[IntEnum]):
    text = declaration(f"DUTs/{name}.TcDUT")
    found = {label: int(number) for label, number in re.findall(r"^\s+(\w+) := (\d+)", text, re.MULTILINE)}
    assert found == {member.name: int(member) for member in kind}
    assert text.startswith("{attribute 'qualified_only'}\n{attribute 'strict'}\n")
    assert f") {base};" in text


@pytest.mark.parametrize(
    ("name", "labels"),
    [
        ("E_HmEvent", [event.name for event in PlcEvent]),
        ("E_HmEffect", [effect.name for effect in PlcAction]),
        ("E_HmMotion", ["FOLLOW", "HOLD", "PLAY", "PATH_STOP", "JOINT_STOP", "SERVO"]),
    ],
)
def test_inner_enumerations_count_from_zero(name, labels):
    found = re.findall(r"^\s+(\w+) := (\d+)", declaration(f"DUTs/{name}.TcDUT"), re.MULTILINE)
    assert found == [(label, str(i)) for i, label in enumerate(labels)]


def test_every_reject_code_carries_its_remedy():
    text = declaration("DUTs/E_HmReject.TcDUT")
    for code in codes.RejectCode:
        assert f"{code.name} := {int(code)}" in text
        assert codes.reject_text(code).removeprefix(f"{code.name}: ") in text


def test_layout_constants():
    found = constants("GVL_HmLayout")
    for field in (*layout.HEADER_LAYOUT.fields, *layout.COMMAND_BODY_LAYOUT.fields):
        assert found.pop(f"OFS_{field.name.upper()}") == ("UDINT", field.offset)
    for field in layout.KNOT_LAYOUT.fields:
        assert found.pop(f"OFS_KNOT_{field.name.upper()}") == ("UDINT", field.offset)
    assert {name: value for name, (_, value) in found.items()} == {
        "CMD_SIZE": 1304, "STATE_SIZE": 568, "LIMITS_SIZE": 288, "HEADER_SIZE": 32, "AXES": 8, "KNOTS": 6,
        "KNOT_SIZE": 200, "CMD_TAG": 1280, "CMD_CRC": 1300, "STATE_TAG": 544, "STATE_CRC": 564, "OFS_KNOTS": 80,
        "CMD_MAGIC": 0x31434D48, "STATE_MAGIC": 0x31534D48, "LAYOUT_ID": 0xAE60A802, "VERSION_MAJOR": 1,
        "VERSION_MINOR": layout.VERSION_MINOR,
    }  # fmt: skip


def test_bit_constants_have_the_type_of_their_field():
    kinds = {
        "HDR": ("UINT", codes.HeaderFlag),
        "CMD": ("UINT", codes.CommandFlag),
        "FAULT": ("ULINT", codes.FaultBit),
        "WARN": ("ULINT", codes.WarnBit),
        "AXIS": ("UDINT", codes.AxisBit),
    }
    expected = {f"{prefix}_{bit.name}": (iec, int(bit)) for prefix, (iec, kind) in kinds.items() for bit in kind}
    assert constants("GVL_HmBits") == expected


def test_times_are_those_of_the_table():
    found = constants("GVL_HmTimes")
    for limit in timeouts.ALL_TIMEOUTS:
        assert found[limit.name.upper().replace(" ", "_") + "_NS"] == ("ULINT", limit.duration_ns)
    assert found["START_TOLERANCE"] == ("LREAL", timeouts.START_TOLERANCE_RAD)
    assert found["RING_KNOTS"] == ("UDINT", 64)


def test_machine_constants_are_the_parameters_to_the_last_bit():
    found = constants("GVL_HmMachine")
    axes = PARAMETERS.limit_table.axes
    columns = {
        "Q_MIN": [axis.q_min for axis in axes],
        "Q_MAX": [axis.q_max for axis in axes],
        "QD_MAX": [axis.qd_max for axis in axes],
        "QDD_MAX": [axis.qdd_max for axis in axes],
        "KP": PARAMETERS.kp_frac_per_rad,
        "PT1_SHARE": PARAMETERS.pt1_share,
        "LAG_WARN": PARAMETERS.lag_warn,
        "LAG_FAULT": PARAMETERS.lag_fault,
    }
    for name, values in columns.items():
        assert found[name] == ("ARRAY[0..7] OF LREAL", [*values, *(8 - len(axes)) * (0.0,)])
    assert found["N_AXES"] == ("UDINT", 6)
    assert found["CYCLE_NS"] == ("ULINT", 1_000_000)
    assert found["CYCLE_S"] == ("LREAL", 1_000_000 * 1e-9)
    assert found["SUPPLY_FAULT"] == ("REAL", 2e6)
    assert found["FADE_SPEED_FACTOR"] == ("LREAL", timeouts.PLAUSIBLE_SPEED_FACTOR)


def test_cfg_id_is_the_crc_of_the_exported_limits():
    """Packed by hand from the constants in the text, as FB_HmSelfCheck does it on the PLC."""
    found, times = constants("GVL_HmMachine"), constants("GVL_HmTimes")
    columns = [found[name][1] for name in ("Q_MIN", "Q_MAX", "QD_MAX", "QDD_MAX")]
    head = (found["N_AXES"][1], 0, times["KNOT_SPACING_MIN_NS"][1], times["KNOT_SPACING_MAX_NS"][1])
    table = struct.pack("<IIQQd32d", *head, times["START_TOLERANCE"][1], *(x for column in columns for x in column))
    assert len(table) == 288
    assert zlib.crc32(table) == found["CFG_ID_EXPECTED"][1] == cfg_id(PARAMETERS.limit_table)


def next_states() -> dict[tuple[str, str], str]:
    """The function's CASE text as a table."""
    table, state, events = {}, "", []
    for line in next_state_source().splitlines():
        text = line.strip()
        if re.fullmatch(r"E_HmPlcState\.\w+:", text):
            state = text.removeprefix("E_HmPlcState.").rstrip(":")
        elif text.startswith("E_HmEvent."):
            events = re.findall(r"E_HmEvent\.(\w+)", text)
        elif found := re.fullmatch(r"eNext := E_HmPlcState\.(\w+);", text):
            table |= {(state, event): found.group(1) for event in events}
    return table


def test_next_state_is_the_transition_table():
    expected = {(state.name, event.name): after.name for (state, event), after in TRANSITIONS.items()}
    assert next_states() == expected
    assert next_state_source().count("F_HmNextState := FALSE;") == len(PlcState) + 1
