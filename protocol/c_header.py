"""A C header of the wire, from the layout table: natural alignment, every size and offset asserted at compile time."""

from enum import Enum

from protocol import codes, layout
from protocol.layout import Block, Field

_C_TYPES = {
    "USINT": "uint8_t",
    "UINT": "uint16_t",
    "UDINT": "uint32_t",
    "ULINT": "uint64_t",
    "REAL": "float",
    "LREAL": "double",
}
# fmt: off
_ENUMS: tuple[type[Enum], ...] = (
    codes.MessageType, codes.Mode, codes.PlcState, codes.LinkState, codes.Interp, codes.RejectCode, codes.HeaderFlag,
    codes.CommandFlag, codes.FaultBit, codes.WarnBit, codes.AxisBit,
)
# fmt: on


def c_header() -> str:
    """The text of hmlink.h; valid as C11 and as C++11."""
    knots = f"    hm_knot_t knots[{layout.KNOTS_PER_COMMAND}];"
    command = [
        *_struct_members(layout.HEADER_LAYOUT),
        *_struct_members(layout.COMMAND_BODY_LAYOUT),
        knots,
        *_struct_members(layout.COMMAND_TAIL_LAYOUT),
    ]
    state = [*_struct_members(layout.HEADER_LAYOUT), *_struct_members(layout.STATE_BODY_LAYOUT)]
    asserts = [
        *_layout_asserts("hm_knot_t", layout.KNOT_SIZE, layout.KNOT_LAYOUT),
        *_layout_asserts(
            "hm_command_t",
            layout.COMMAND_SIZE,
            layout.HEADER_LAYOUT,
            layout.COMMAND_BODY_LAYOUT,
            layout.COMMAND_TAIL_LAYOUT,
        ),
        f'HM_ASSERT(offsetof(hm_command_t, knots) == {layout.KNOTS_OFFSET}, "knots");',
        *_layout_asserts("hm_state_t", layout.STATE_SIZE, layout.HEADER_LAYOUT, layout.STATE_BODY_LAYOUT),
        *_layout_asserts("hm_limits_t", layout.LIMIT_TABLE_LAYOUT.codec.size, layout.LIMIT_TABLE_LAYOUT),
    ]
    parts = (
        _HEAD,
        *(_enum_declaration(kind) for kind in _ENUMS),
        _struct_typedef("hm_knot_t", _struct_members(layout.KNOT_LAYOUT)),
        _struct_typedef("hm_command_t", command),
        _struct_typedef("hm_state_t", state),
        "/* Never sent: cfg_id is the CRC-32 of it, unused axes 0. */\n"
        + _struct_typedef("hm_limits_t", _struct_members(layout.LIMIT_TABLE_LAYOUT)),
        "\n".join(asserts),
        "#endif /* HMLINK_H */\n",
    )
    return "\n\n".join(parts)


_HEAD = f"""\
/* HMLINK {layout.VERSION_MAJOR}.{layout.VERSION_MINOR}: command and state of the PLC link.
 * Generated from the layout table: do not edit.
 *
 * Little endian; angles in rad, times in ns, pressures in Pa, valve commands -1..1.
 * Natural alignment equals packing, so no pragma is needed. The last 4 bytes of command
 * and state are the CRC-32 (IEEE 802.3, as zlib's) of all bytes before.
 * Test floating point fields for finite before use. */
#ifndef HMLINK_H
#define HMLINK_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
#define HM_ASSERT(condition, text) static_assert(condition, text)
#else
#define HM_ASSERT(condition, text) _Static_assert(condition, text)
#endif

#define HM_COMMAND_MAGIC UINT32_C({layout.COMMAND_MAGIC:#010x})
#define HM_STATE_MAGIC UINT32_C({layout.STATE_MAGIC:#010x})
#define HM_LAYOUT_ID UINT32_C({layout.LAYOUT_ID:#010x})
#define HM_VERSION_MAJOR {layout.VERSION_MAJOR}
#define HM_VERSION_MINOR {layout.VERSION_MINOR}"""


def _struct_members(block: Block) -> list[str]:
    return [f"    {_C_TYPES[f.iec_type]} {f.name}{_array_suffix(f)}; /* {f.offset} */" for f in block.fields]


def _array_suffix(field: Field) -> str:
    return f"[{field.array_length}]" if field.array_length > 1 else ""


def _struct_typedef(name: str, members: list[str]) -> str:
    return "typedef struct {\n" + "\n".join(members) + f"\n}} {name};"


def _layout_asserts(name: str, size: int, *blocks: Block) -> list[str]:
    """Size of the struct, and place and size of every field: padding could hide a field that is too small."""
    rows = [f'HM_ASSERT(sizeof({name}) == {size}, "{name}");']
    for block in blocks:
        for f in block.fields:
            rows.append(f'HM_ASSERT(offsetof({name}, {f.name}) == {f.offset}, "{f.name}");')
            rows.append(f'HM_ASSERT(sizeof((({name} *)0)->{f.name}) == {f.size}, "{f.name}");')
    return rows


def _enum_declaration(kind: type[Enum]) -> str:
    prefix = "".join(f"_{c}" if c.isupper() else c.upper() for c in kind.__name__).lstrip("_")
    rows = [f"    HM_{prefix}_{member.name} = {int(member.value)}" for member in kind]
    return "enum {\n" + ",\n".join(rows) + "\n};"
