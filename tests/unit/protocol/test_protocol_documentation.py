"""docs/plc-link.md must say what the code does: its tables are the generated ones."""

from pathlib import Path

import pytest

from protocol import codes, layout, plc_states, timeouts

PAGE = (Path(__file__).parents[3] / "docs" / "plc-link.md").read_text()


@pytest.mark.parametrize("block", layout.MESSAGE_BLOCK_LAYOUTS, ids=lambda block: block.name)
def test_offsets(block: layout.Block) -> None:
    assert layout.offsets_markdown(block) in PAGE


def test_states_timeouts_and_codes() -> None:
    assert plc_states.mermaid_diagram() in PAGE
    assert timeouts.table_markdown() in PAGE
    assert codes.rejects_markdown() in PAGE
    assert f"{layout.LAYOUT_ID:#010x}" in PAGE


@pytest.mark.parametrize(
    "enum",
    [codes.MessageType, codes.Mode, codes.PlcState, codes.LinkState, codes.Interp],
    ids=lambda enum: enum.__name__,
)
def test_numbers_of_enumerations(enum: type) -> None:
    assert ", ".join(f"{member.value} {member.name}" for member in enum) in PAGE  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    "flags",
    [codes.HeaderFlag, codes.CommandFlag, codes.FaultBit, codes.WarnBit, codes.AxisBit],
    ids=lambda flags: flags.__name__,
)
def test_numbers_of_bits(flags: type) -> None:
    for member in flags:  # type: ignore[attr-defined]
        assert f"bit {member.value.bit_length() - 1} {member.name}" in PAGE
