"""Natural alignment must equal packing, or a PLC with another pack_mode reads other bytes."""

import ctypes

import pytest

from protocol import layout
from protocol.layout import Block

C_TYPES = {
    "USINT": ctypes.c_uint8,
    "UINT": ctypes.c_uint16,
    "UDINT": ctypes.c_uint32,
    "ULINT": ctypes.c_uint64,
    "REAL": ctypes.c_float,
    "LREAL": ctypes.c_double,
}


def c_fields(*blocks: Block) -> list[tuple[str, type]]:
    fields = []
    for block in blocks:
        for field in block.fields:
            kind = C_TYPES[field.iec_type]
            fields.append(
                (f"{field.name}_{field.offset}", kind if field.array_length == 1 else kind * field.array_length)
            )
    return fields


class NaturalKnot(ctypes.LittleEndianStructure):
    _fields_ = c_fields(layout.KNOT_LAYOUT)


class NaturalCommand(ctypes.LittleEndianStructure):
    _fields_ = (
        *c_fields(layout.HEADER_LAYOUT, layout.COMMAND_BODY_LAYOUT),
        ("knots", NaturalKnot * layout.KNOTS_PER_COMMAND),
        *c_fields(layout.COMMAND_TAIL_LAYOUT),
    )


class NaturalState(ctypes.LittleEndianStructure):
    _fields_ = c_fields(layout.HEADER_LAYOUT, layout.STATE_BODY_LAYOUT)


@pytest.mark.parametrize(
    ("natural", "size", "blocks"),
    [
        (NaturalKnot, layout.KNOT_SIZE, (layout.KNOT_LAYOUT,)),
        (
            NaturalCommand,
            layout.COMMAND_SIZE,
            (layout.HEADER_LAYOUT, layout.COMMAND_BODY_LAYOUT, layout.COMMAND_TAIL_LAYOUT),
        ),
        (NaturalState, layout.STATE_SIZE, (layout.HEADER_LAYOUT, layout.STATE_BODY_LAYOUT)),
    ],
)
def test_a_c_compiler_puts_every_field_where_the_table_says(
    natural: type[ctypes.Structure], size: int, blocks: tuple[Block, ...]
) -> None:
    assert ctypes.sizeof(natural) == size
    for block in blocks:
        for field in block.fields:
            assert getattr(natural, f"{field.name}_{field.offset}").offset == field.offset, field


def test_sizes_and_overhead_fit_one_frame() -> None:
    assert (layout.COMMAND_SIZE, layout.STATE_SIZE) == (1304, 568)  # bytes
    assert NaturalCommand.knots.offset == 80
    assert layout.COMMAND_SIZE + 22 < 1400  # bytes, with EAP


def test_a_gap_in_the_table_is_refused() -> None:
    with pytest.raises(ValueError, match="the field before ends at 4"):
        layout._contiguous_block("x", 12, layout.Field(0, "UDINT", "a"), layout.Field(8, "UDINT", "b"))
    with pytest.raises(ValueError, match="must end at 8"):
        layout._contiguous_block("x", 8, layout.Field(0, "UDINT", "a"))
