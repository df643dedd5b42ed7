"""The exported pages: generated from the tables, and true of the program they go with."""

import re

import pytest
from export_parts import PARAMETERS, constants, exported

from longreach.export_command import st_sources
from protocol import codes, layout, plc_states, timeouts
from protocol.layout import LAYOUT_ID
from protocol.limits import cfg_id
from protocol.plc_states import PlcEvent

GLOBALS = "GVLs/GVL_HmIo.TcGVL"


def page(path: str) -> str:
    return exported()[path].decode()


def test_tables_are_the_generated_ones():
    for block in (*layout.MESSAGE_BLOCK_LAYOUTS, layout.LIMIT_TABLE_LAYOUT):
        assert layout.offsets_markdown(block) in page("docs/offsets.md")
    assert timeouts.table_markdown() in page("docs/timeouts.md")
    assert plc_states.mermaid_diagram() in page("docs/states.md")
    assert codes.rejects_markdown() in page("docs/reject-codes.md")
    for event in PlcEvent:
        assert f"| {event.name} | {event.value} |" in page("docs/states.md")


def test_the_eap_sheet_holds_what_both_ends_need():
    rows = dict(re.findall(r"^\| (.+?) \| (.+?) \|$", page("eap/configuration-sheet.md"), re.MULTILINE))
    version = LAYOUT_ID & 0xFFFF
    assert version == 0xA802
    assert rows["Subscriber variable: id, type, size"] == "0x4801, ST_HmCmd, 1304 bytes"
    assert rows["Publisher variable: id, type, size"] == "0x4802, ST_HmState, 568 bytes"
    assert rows["Subscriber: DataType Version"].startswith("0xa802 (43010)")
    assert rows["Publisher: DataType Version"] == "0xa802 (43010)"
    assert rows["PLC: AMS NetId, IP"] == "10.1.2.4.1.1, 10.1.2.4"
    assert rows["PC: AMS NetId, IP"] == "10.1.2.3.1.1, 10.1.2.3"
    assert rows["UDP port"].startswith("34980")
    assert "unicast" in rows["Subscriber: publisher"]
    assert "unicast" in rows["Publisher: target"]
    assert rows["Publisher: cycle"] == "10 ms"
    assert rows["UDP payload of a command"] == "1326 bytes"
    assert "Screenshots" in page("eap/configuration-sheet.md")
    assert "EDC" in page("eap/configuration-sheet.md")
    assert not any(path.endswith(".edc") or path.endswith(".xml") for path in exported())


@pytest.mark.parametrize("path", ["README.md", "docs/commissioning.md"])
def test_what_is_not_verified_is_said(path):
    text = page(path)
    assert "Nothing here has run on a real TwinCAT runtime" in text
    for subject in ("VarState", "TF6311", "XAE imports", "longest cycle"):
        assert subject in text.partition("## What is not verified")[2]


def test_every_variable_that_a_page_names_exists():
    sources, io = st_sources(), page(f"twincat/{GLOBALS}")
    text = "".join(page(path) for path in exported() if path.endswith(".md"))
    for name in set(re.findall(r"GVL_HmIo\.(\w+)", text)):
        assert re.search(rf"^\s+{name}\b.*:", io, re.MULTILINE), name
    for name in set(re.findall(r"MAIN\.fbPlc\.(\w+)", text)):
        assert re.search(rf"^\s+{name} :", sources["FB_HmPlc.st"], re.MULTILINE), name
    fields = {field.name for field in (*layout.HEADER_LAYOUT.fields, *layout.STATE_BODY_LAYOUT.fields)}
    named = set(re.findall(r"MAIN\.uTx\.m\.(\w+)", text))
    assert len(named) > 5
    assert named <= fields
    for block in set(re.findall(r"\b(FB_\w+|GVL_Hm\w+)\b", text)):
        assert any(path.rpartition("/")[2].startswith(f"{block}.") for path in exported()), block


def test_the_start_page_leads_to_a_dry_run():
    text = page("README.md")
    assert f"{cfg_id(PARAMETERS.limit_table):#010x}" in text
    assert f"| axes | {', '.join(axis.name for axis in PARAMETERS.limit_table.axes)} |" in text
    assert "`longreach commission --framing eap --plc-host 10.1.2.4`" in text
    assert "bDryRun : BOOL := TRUE" in page(f"twincat/{GLOBALS}")
    assert text.index("**Import**") < text.index("**Dry run**") < text.index("**PC**")
    assert len(text.splitlines()) < 90  # one page


def test_the_commissioning_page_begins_with_closed_valves_and_has_every_joint():
    text = page("docs/commissioning.md")
    assert text.index("**Dry run** (`bDryRun` TRUE)") < text.index("**Valves, joint by joint** (`bDryRun` FALSE")
    limits = constants("GVL_HmMachine")
    for j, axis in enumerate(PARAMETERS.limit_table.axes):
        (row,) = re.findall(rf"^\| {axis.name} \| (.+) \|$", text, re.MULTILINE)
        shown = [float(x) for x in row.split(" | ")]
        own = [limits[name][1][j] for name in ("Q_MIN", "Q_MAX", "QD_MAX", "QDD_MAX")]  # type: ignore[index]
        assert shown[:4] == pytest.approx(own, abs=5e-5)
        assert shown[4] == pytest.approx(own[2] / own[3], abs=5e-3)


def test_no_page_has_lines_that_do_not_fit_a_screen():
    for path in exported():
        if path.endswith(".md") and not path.startswith("vectors/"):
            long = [line for line in page(path).splitlines() if len(line) > 125 and not line.startswith("|")]
            assert not long, path
