"""The export as files: deterministic, complete, well-formed, nothing of the hand-written blocks lost."""

import hashlib
import re
from dataclasses import replace
from xml.etree import ElementTree

import pytest
from export_parts import MACHINE, PARAMETERS, exported

from longreach.export_command import plc_parameters, st_sources
from protocol.errors import LocalProtocolError
from protocol.twincat.bundle import build_bundle_files, project
from protocol.twincat.pou import parse_pou
from protocol.twincat.solution import PLC_PROJECT_NAME

SOURCE = """\
(* purpose; METHOD and END_VAR in a comment are text *)
FUNCTION_BLOCK FB_X
VAR
    a : LREAL; // END_VAR
END_VAR
VAR CONSTANT
    B : LREAL := 1.0;
END_VAR

a := a + B;

(* belongs to M *)
METHOD M : BOOL
VAR_INPUT
    c : LREAL;
END_VAR
M := c > a;
END_METHOD

METHOD N
a := 0.0;
END_METHOD
END_FUNCTION_BLOCK
"""


def test_two_exports_are_the_same_bytes():
    again = build_bundle_files(
        plc_parameters(MACHINE, "10.1.2.3.1.1", "10.1.2.4.1.1"), dict(reversed(st_sources().items()))
    )
    assert again == exported()
    assert list(again) == list(exported())


def test_no_file_holds_a_time_stamp_or_carriage_return():
    for path, data in exported().items():
        if path.endswith(".pcap"):
            continue
        text = data.decode("utf-8")
        assert "\r" not in text, path
        assert not re.search(r"\b20\d\d-[01]\d-[0-3]\d\b", text), path
        assert text.endswith("\n"), path


def test_what_is_in_the_export():
    paths = set(exported())
    assert {
        "README.md", "MANIFEST.txt", "c/hmlink.h", "wireshark/hmlink.lua", "eap/configuration-sheet.md",
        "vectors/eap.pcap", "vectors/raw.pcap", "vectors/conversation.md", "vectors/conversation.json",
        "docs/commissioning.md", "docs/offsets.md", "docs/timeouts.md", "docs/states.md", "docs/reject-codes.md",
        "docs/import.md", "twincat/DUTs/ST_HmCmd.TcDUT", "twincat/GVLs/GVL_HmIo.TcGVL",
        "twincat/POUs/F_HmNextState.TcPOU",
    } <= paths  # fmt: skip
    assert {f"twincat/POUs/{name.removesuffix('.st')}.TcPOU" for name in st_sources()} <= paths


def test_the_manifest_names_versions_and_every_file():
    head, *rows = exported()["MANIFEST.txt"].decode().splitlines()
    assert head.startswith("# HMLINK 1.1 for hiab033: layout_id 0xae60a802, cfg_id 0x")
    found = {path: digest for digest, path in (row.split("  ") for row in rows)}
    assert found == {
        path: hashlib.sha256(data).hexdigest() for path, data in exported().items() if path != "MANIFEST.txt"
    }


def test_twincat_files_are_well_formed_and_their_ids_unique():
    ids = []
    for path, data in exported().items():
        if not path.endswith((".TcDUT", ".TcGVL", ".TcPOU")):
            continue
        root = ElementTree.fromstring(data)
        (item,) = root
        assert root.tag == "TcPlcObject"
        assert item.attrib["Name"] == path.rpartition("/")[2].rpartition(".")[0]
        assert item.tag == {"TcDUT": "DUT", "TcGVL": "GVL", "TcPOU": "POU"}[path.rpartition(".")[2]]
        ids += [element.attrib["Id"] for element in root.iter() if "Id" in element.attrib]
    assert len(ids) > 100
    assert len(set(ids)) == len(ids)
    assert all(re.fullmatch(r"\{[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}\}", identity) for identity in ids)


def test_ids_do_not_depend_on_the_machine():
    other = project(replace(PARAMETERS, machine_name="other", range_margin_rad=0.1), st_sources())
    identity = re.compile(rb'Id="(\{[^"]+\})"')
    assert other["GVLs/GVL_HmMachine.TcGVL"] != exported()["twincat/GVLs/GVL_HmMachine.TcGVL"]
    for path, data in other.items():
        assert identity.findall(data) == identity.findall(exported()[f"twincat/{path}"])


@pytest.mark.parametrize("name", sorted(st_sources()))
def test_no_line_of_a_hand_written_block_is_lost(name):
    texts = ElementTree.fromstring(exported()[f"twincat/POUs/{name.removesuffix('.st')}.TcPOU"]).itertext()
    exported_lines = [line.strip() for text in texts for line in text.splitlines() if line.strip()]
    ends = {"END_METHOD", "END_FUNCTION_BLOCK", "END_FUNCTION", "END_PROGRAM"}
    lines = [line.strip() for line in st_sources()[name].splitlines() if line.strip()]
    assert sorted(exported_lines) == sorted(line for line in lines if line not in ends)


def test_the_generated_part_needs_no_source():
    files = project(PARAMETERS, {})
    assert [path for path in files if path.startswith("POUs/")] == ["POUs/F_HmNextState.TcPOU"]
    assert len([path for path in files if path.startswith("DUTs/")]) == 18


def test_a_source_is_taken_apart_into_declaration_body_and_methods():
    pou = parse_pou(SOURCE)
    assert (pou.kind, pou.name) == ("FUNCTION_BLOCK", "FB_X")
    assert pou.declaration.startswith("(* purpose;")
    assert pou.declaration.endswith("B : LREAL := 1.0;\nEND_VAR\n")
    assert pou.body == "a := a + B;\n"
    m, n = pou.methods
    assert (m.name, m.body) == ("M", "M := c > a;\n")
    assert m.declaration == "(* belongs to M *)\nMETHOD M : BOOL\nVAR_INPUT\n    c : LREAL;\nEND_VAR\n"
    assert (n.name, n.declaration, n.body) == ("N", "METHOD N\n", "a := 0.0;\n")


@pytest.mark.parametrize(
    ("sources", "told"),
    [
        ({"FB_X.st": "VAR\nEND_VAR\n"}, "none of FUNCTION_BLOCK"),
        ({"FB_X.st": SOURCE.replace("END_FUNCTION_BLOCK", "")}, "END_FUNCTION_BLOCK is missing"),
        ({"FB_X.st": SOURCE.replace("END_METHOD", "", 1)}, "METHOD M has no END_METHOD"),
        ({"FB_X.st": SOURCE.replace("\nMETHOD N", "a := 1.0;\nMETHOD N")}, "statements after METHOD M"),
        (
            {"FB_X.st": SOURCE.replace("END_FUNCTION_BLOCK", "a := 1.0;\nEND_FUNCTION_BLOCK")},
            "statements after METHOD N",
        ),
        ({"FB_Y.st": SOURCE}, "FB_Y.st holds FB_X"),
        ({"FB_X.st": SOURCE.replace("purpose", "]]>")}, "cannot stand in a TwinCAT file"),
    ],
)
def test_a_source_that_is_no_block_is_refused(sources, told):
    with pytest.raises(LocalProtocolError, match=re.escape(told)):
        project(PARAMETERS, sources)


#: What TwinCAT 3.1 keeps for itself, in capitals: a name is the same in any letters, and `nE` is its operator NE.
WORDS = """
    ABS ACOS ACTION ADD ADR AND AND_THEN ANY ARRAY ASIN AT ATAN BITADR BOOL BY BYTE CAL CASE CONSTANT CONTINUE
    COS DATE DINT DIV DO DT DWORD ELSE ELSIF END EQ EXIT EXP EXPT EXTENDS FALSE FINAL FOR FUNCTION GE GT IF
    IMPLEMENTS INDEXOF INI INT INTERFACE INTERNAL JMP LE LIMIT LINT LN LOG LREAL LT LTIME LWORD MAX METHOD MIN
    MOD MOVE MUL MUX NE NOT OF OR OR_ELSE PERSISTENT POINTER PRIVATE PROGRAM PROPERTY PROTECTED PUBLIC REAL REF
    REFERENCE REPEAT RET RETAIN RETURN ROL ROR SEL SHL SHR SIN SINT SIZEOF SQRT STRING STRUCT SUB SUPER TAN THEN
    THIS TIME TO TOD TRUE TRUNC TYPE UDINT UINT ULINT UNION UNTIL USINT VAR WHILE WORD WSTRING XOR __DELETE
    __ISVALIDREF __NEW __QUERYINTERFACE __QUERYPOINTER
"""
KEPT = frozenset(WORDS.split())
DECLARED = re.compile(
    r"^\s*(?:METHOD|FUNCTION_BLOCK|FUNCTION|PROGRAM)\s+(\w+)|^\s*(\w+(?:\s*,\s*\w+)*)\s*(?:AT\s+%\S+\s*)?:(?!=)", re.M
)


def test_no_name_is_one_of_the_compilers_own():
    texts = {name: data.decode() for name, data in exported().items() if name.endswith((".TcPOU", ".TcDUT", ".TcGVL"))}
    declared = {
        (name, one.strip())
        for name, text in texts.items()
        for groups in DECLARED.findall(text)
        for one in ",".join(filter(None, groups)).split(",")
    }
    assert len(declared) > 500
    assert {pair for pair in declared if pair[1].upper() in KEPT} == set()
    assert DECLARED.findall("    nE : DWORD;\nMETHOD Add") == [("", "nE"), ("Add", "")]


# The project around the files, read as XML and as text.

MSBUILD = "{http://schemas.microsoft.com/developer/msbuild/2003}"


def plc_project():
    return ElementTree.fromstring(exported()[f"twincat/{PLC_PROJECT_NAME}.plcproj"])


def test_the_project_lists_every_file_of_the_program_and_no_other():
    listed = [item.get("Include").replace("\\", "/") for item in plc_project().iter(f"{MSBUILD}Compile")]
    exported_files = {path.removeprefix("twincat/") for path in exported() if path.startswith("twincat/")}
    own = {f"{PLC_PROJECT_NAME}.plcproj", f"{PLC_PROJECT_NAME}.tsproj", f"{PLC_PROJECT_NAME}.sln"}
    assert len(listed) == len(set(listed))
    assert set(listed) == exported_files - own
    folders = {item.get("Include") for item in plc_project().iter(f"{MSBUILD}Folder")}
    assert folders == {path.partition("/")[0] for path in listed if "/" in path}


def test_only_the_blocks_that_need_a_product_are_left_out_of_the_build():
    left_out = {
        item.get("Include").rpartition("\\")[2].partition(".")[0]
        for item in plc_project().iter(f"{MSBUILD}Compile")
        if item.findtext(f"{MSBUILD}ExcludeFromBuild") == "true"
    }
    assert left_out == {"FB_HmUdpTf6310", "FB_HmUdpTf6311"}
    built = "".join(data.decode() for path, data in exported().items() if path.endswith(".TcPOU"))
    assert len(re.findall(r"FB_HmUdpTf631[01]", built)) > 0


def test_the_task_has_the_machines_cycle_and_calls_main():
    task = ElementTree.fromstring(exported()["twincat/PlcTask.TcTTO"]).find("Task")
    assert int(task.findtext("CycleTime")) * 1000 == PARAMETERS.cycle_ns
    assert task.findtext("PouCall/Name") == "MAIN"
    assert "twincat/POUs/MAIN.TcPOU" in exported()


def test_solution_project_and_task_agree():
    solution = exported()[f"twincat/{PLC_PROJECT_NAME}.sln"].decode()
    (found,) = re.findall(r'^Project\("(\{[^"]+\})"\) = "\w+", "([^"]+)", "(\{[^"]+\})"$', solution, re.MULTILINE)
    root = ElementTree.fromstring(exported()[f"twincat/{found[1]}"])
    assert root.find("Project").get("ProjectGUID").upper() == found[2]
    plc = root.find("Project/Plc/Project")
    assert f"twincat/{plc.get('PrjFilePath')}" in exported()
    assert plc.get("GUID") == plc_project().findtext(f"{MSBUILD}PropertyGroup/{MSBUILD}ProjectGuid")
    task = root.find("Project/System/Tasks/Task")
    context = plc.find("Instance/Contexts/Context")
    assert int(task.get("CycleTime")) * 100 == int(context.findtext("CycleTime")) == PARAMETERS.cycle_ns
    assert task.findtext("Name") == context.findtext("Name") == "PlcTask"
    ids = re.findall(r"\{[0-9a-fA-F-]{36}\}", exported()[f"twincat/{PLC_PROJECT_NAME}.plcproj"].decode())
    assert len(ids) == len(set(ids))
