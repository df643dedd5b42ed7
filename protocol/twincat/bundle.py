"""Everything that a PLC engineer gets, as a table from path to bytes; the same input gives the same bytes."""

import hashlib
import uuid
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum, IntEnum
from xml.sax.saxutils import quoteattr

from protocol import codes, layout
from protocol.c_header import c_header
from protocol.codes import PlcState
from protocol.errors import LocalProtocolError
from protocol.layout import N_AXIS_SLOTS, Block, Field
from protocol.limits import cfg_id
from protocol.plc_events import PlcAction
from protocol.plc_states import TRANSITIONS, PlcEvent
from protocol.twincat import documents, guides
from protocol.twincat.golden import golden_pcap
from protocol.twincat.golden_pages import golden_json, golden_page
from protocol.twincat.gvl import gvls
from protocol.twincat.parameters import PlcParameters
from protocol.twincat.pou import Pou, parse_pou
from protocol.twincat.solution import solution_files
from protocol.wireshark import lua_dissector

# Wire structs as TwinCAT types from the layout table, with the unions that access their bytes.

_PACK = "{attribute 'pack_mode' := '1'}"


@dataclass(frozen=True, slots=True)
class Dut:
    """One data type: its name and its declaration."""

    name: str
    declaration: str


def duts() -> tuple[Dut, ...]:
    """Structs and unions of the wire, of the limits table, and of the machine's readings."""
    knots = f"    aKnots : ARRAY[0..{layout.KNOTS_PER_COMMAND - 1}] OF ST_HmKnot; // {layout.KNOTS_OFFSET}"
    command = [
        *_field_declarations(layout.HEADER_LAYOUT),
        *_field_declarations(layout.COMMAND_BODY_LAYOUT),
        knots,
        *_field_declarations(layout.COMMAND_TAIL_LAYOUT),
    ]
    return (
        _struct_dut("ST_HmKnot", "One point of the reference.", _field_declarations(layout.KNOT_LAYOUT)),
        _struct_dut("ST_HmCmd", "PC to PLC; comments: byte offsets.", command),
        _struct_dut(
            "ST_HmState",
            "PLC to PC.",
            [*_field_declarations(layout.HEADER_LAYOUT), *_field_declarations(layout.STATE_BODY_LAYOUT)],
        ),
        _struct_dut(
            "ST_HmLimits", "What cfg_id is the CRC-32 of; never sent.", _field_declarations(layout.LIMIT_TABLE_LAYOUT)
        ),
        _struct_dut("ST_HmSample", "This machine's readings of one cycle: rad, rad/s, Pa, degC.", _SAMPLE),
        _union_dut("U_HmCmd", "ST_HmCmd", layout.COMMAND_SIZE),
        _union_dut("U_HmState", "ST_HmState", layout.STATE_SIZE),
        _union_dut("U_HmLimits", "ST_HmLimits", layout.LIMIT_TABLE_LAYOUT.codec.size),
        _union_dut("U_HmSample", "ST_HmSample", _SAMPLE_SIZE),
    )


_SAMPLE_SIZE = 2 * 8 * N_AXIS_SLOTS + 2 * 4 * N_AXIS_SLOTS + 16
_SAMPLE = [
    f"    aQ : ARRAY[0..{N_AXIS_SLOTS - 1}] OF LREAL; // encoders",
    f"    aQd : ARRAY[0..{N_AXIS_SLOTS - 1}] OF LREAL;",
    f"    aPa : ARRAY[0..{N_AXIS_SLOTS - 1}] OF REAL; // chamber pressures",
    f"    aPb : ARRAY[0..{N_AXIS_SLOTS - 1}] OF REAL;",
    "    fSupply : REAL;",
    "    fTank : REAL;",
    "    fOil : REAL;",
    "    fReserved : REAL; // fills up to 8 bytes",
]


def _field_declarations(block: Block) -> list[str]:
    return [f"    {field.name} : {_iec_type(field)}; // {field.offset}" for field in block.fields]


def _iec_type(field: Field) -> str:
    if field.array_length == 1:
        return field.iec_type
    base = "BYTE" if field.iec_type == "USINT" else field.iec_type
    return f"ARRAY[0..{field.array_length - 1}] OF {base}"


def _struct_dut(name: str, purpose: str, lines: list[str]) -> Dut:
    body = "\n".join(lines)
    return Dut(name, f"(* {purpose} *)\n{_PACK}\nTYPE {name} :\nSTRUCT\n{body}\nEND_STRUCT\nEND_TYPE\n")


def _union_dut(name: str, struct: str, size: int) -> Dut:
    text = (
        f"(* {struct} (m), its bytes (b), and its words (w) for finite tests on bits. *)\nTYPE {name} :\nUNION\n"
        f"    m : {struct};\n    b : ARRAY[0..{size - 1}] OF BYTE;\n    w : ARRAY[0..{size // 8 - 1}] OF ULINT;\n"
        "END_UNION\nEND_TYPE\n"
    )
    return Dut(name, text)


MANIFEST_FILE_NAME = "MANIFEST.txt"


# The TwinCAT files of one machine, as a table from path to bytes; the same input gives the same bytes.

# TwinCAT's file form: TcPlcObject XML around ST text, with ids that are the same in every export.

_NAMESPACE = uuid.uuid5(uuid.NAMESPACE_DNS, "hmlink.longreach")
_HEAD = '<?xml version="1.0" encoding="utf-8"?>\n<TcPlcObject Version="1.1.0.1" ProductVersion="3.1.4024.0">\n'


def dut_xml(name: str, text: str) -> str:
    """A .TcDUT file."""
    return (
        f"{_HEAD}  <DUT Name={quoteattr(name)} Id={_guid('DUT', name)}>\n{_declaration(text)}  </DUT>\n</TcPlcObject>\n"
    )


def gvl_xml(name: str, text: str) -> str:
    """A .TcGVL file."""
    return (
        f"{_HEAD}  <GVL Name={quoteattr(name)} Id={_guid('GVL', name)}>\n{_declaration(text)}  </GVL>\n</TcPlcObject>\n"
    )


def pou_xml(pou: Pou) -> str:
    """A .TcPOU file with its methods."""
    parts = [_declaration(pou.declaration), _implementation_xml(pou.body)]
    for method in pou.methods:
        identity = _guid("METHOD", f"{pou.name}.{method.name}")
        parts.append(f"    <Method Name={quoteattr(method.name)} Id={identity}>\n")
        parts.append(_declaration(method.declaration) + _implementation_xml(method.body) + "    </Method>\n")
    special = ' SpecialFunc="None"'
    head = f"  <POU Name={quoteattr(pou.name)} Id={_guid('POU', pou.name)}{special}>\n"
    return f"{_HEAD}{head}{''.join(parts)}  </POU>\n</TcPlcObject>\n"


def _guid(kind: str, name: str) -> str:
    return quoteattr("{" + str(uuid.uuid5(_NAMESPACE, f"{kind} {name}")) + "}")


def _cdata(text: str) -> str:
    if "]]>" in text:
        raise LocalProtocolError("ST source: ']]>' cannot stand in a TwinCAT file; write '] ]>'")
    return f"<![CDATA[{text}]]>"


def _declaration(text: str) -> str:
    return f"    <Declaration>{_cdata(text)}</Declaration>\n"


def _implementation_xml(text: str) -> str:
    return f"    <Implementation>\n      <ST>{_cdata(text)}</ST>\n    </Implementation>\n"


# Enumerations of the wire and of the program's inside, from the code tables.

_WIRE: tuple[tuple[str, str, type[IntEnum]], ...] = (
    ("E_HmMsgType", "USINT", codes.MessageType),
    ("E_HmMode", "UINT", codes.Mode),
    ("E_HmPlcState", "USINT", codes.PlcState),
    ("E_HmLinkState", "USINT", codes.LinkState),
    ("E_HmInterp", "USINT", codes.Interp),
)
_MOTIONS = ("FOLLOW", "HOLD", "PLAY", "PATH_STOP", "JOINT_STOP", "SERVO")


def enums() -> tuple[Dut, ...]:
    """All enumerations."""
    rejects = [(code.name, int(code), codes.reject_text(code).partition(": ")[2]) for code in codes.RejectCode]
    return (
        *(_enum_dut(name, base, [(member.name, int(member), "") for member in kind]) for name, base, kind in _WIRE),
        _enum_dut("E_HmReject", "UINT", rejects),
        _enum_dut("E_HmEvent", "USINT", _numbered_enum_members(PlcEvent)),
        _enum_dut("E_HmEffect", "USINT", _numbered_enum_members(PlcAction)),
        _enum_dut("E_HmMotion", "USINT", [(name, i, "") for i, name in enumerate(_MOTIONS)]),
    )


def _numbered_enum_members(kind: Iterable[Enum]) -> list[tuple[str, int, str]]:
    return [(member.name, i, str(member.value)) for i, member in enumerate(kind)]


def _enum_dut(name: str, base: str, members: list[tuple[str, int, str]]) -> Dut:
    rows = []
    for i, (member, number, remark) in enumerate(members):
        comma = "," if i + 1 < len(members) else ""
        rows.append(f"    {member} := {number}{comma}{f' // {remark}' if remark else ''}")
    body = "\n".join(rows)
    text = f"{{attribute 'qualified_only'}}\n{{attribute 'strict'}}\nTYPE {name} :\n(\n{body}\n) {base};\nEND_TYPE\n"
    return Dut(name, text)


# The state machine as an ST function, from the one transition table.

NEXT_STATE_FUNCTION_NAME = "F_HmNextState"


def next_state_source() -> str:
    """`F_HmNextState`: FALSE, and the state unchanged, for an event that has no place there."""
    cases = "\n".join(_state_case_st(state) for state in PlcState)
    return f"""\
(* The state after an event; generated from the transition table. FALSE: it has no place in this state. *)
FUNCTION {NEXT_STATE_FUNCTION_NAME} : BOOL
VAR_INPUT
    eState : E_HmPlcState;
    eEvent : E_HmEvent;
END_VAR
VAR_OUTPUT
    eNext : E_HmPlcState;
END_VAR
eNext := eState;
{NEXT_STATE_FUNCTION_NAME} := TRUE;
CASE eState OF
{cases}
ELSE
    {NEXT_STATE_FUNCTION_NAME} := FALSE;
END_CASE
END_FUNCTION
"""


def _state_case_st(state: PlcState) -> str:
    after: dict[PlcState, list[PlcEvent]] = {}
    for (before, event), new in TRANSITIONS.items():
        if before is state:
            after.setdefault(new, []).append(event)
    branches = []
    for new, events in after.items():
        labels = ", ".join(f"E_HmEvent.{event.name}" for event in events)
        branches.append(f"            {labels}:\n                eNext := E_HmPlcState.{new.name};")
    body = "\n".join(branches)
    other = f"        ELSE\n            {NEXT_STATE_FUNCTION_NAME} := FALSE;\n        END_CASE"
    return f"    E_HmPlcState.{state.name}:\n        CASE eEvent OF\n{body}\n{other}"


def project(parameters: PlcParameters, sources: Mapping[str, str]) -> dict[str, bytes]:
    """Every file of the PLC program: DUTs/, GVLs/, POUs/.

    Args:    sources: the hand-written blocks, file name to text.
    Raises: LocalProtocolError: a source that is not a POU, or not named like its file.
    """
    files = {f"DUTs/{dut.name}.TcDUT": dut_xml(dut.name, dut.declaration) for dut in (*duts(), *enums())}
    files |= {f"GVLs/{gvl.name}.TcGVL": gvl_xml(gvl.name, gvl.declaration) for gvl in gvls(parameters)}
    pous = [parse_pou(next_state_source()), *(_parse_pou_matching_file(name, text) for name, text in sources.items())]
    files |= {f"POUs/{pou.name}.TcPOU": pou_xml(pou) for pou in pous}
    return {path: files[path].encode("utf-8") for path in sorted(files)}


def _parse_pou_matching_file(file_name: str, text: str) -> Pou:
    pou = parse_pou(text)
    if file_name.removesuffix(".st") != pou.name:
        raise LocalProtocolError(f"ST source {file_name} holds {pou.name}; name the file {pou.name}.st")
    return pou


def build_bundle_files(parameters: PlcParameters, sources: Mapping[str, str]) -> dict[str, bytes]:
    """All files; `sources` are the hand-written blocks, file name to text.

    Raises: LocalProtocolError: a source that is not a POU.
    """
    texts = {
        "README.md": guides.start_page(parameters),
        "docs/commissioning.md": guides.commissioning_page(parameters),
        "docs/import.md": guides.import_page(),
        "docs/offsets.md": documents.offsets_page(),
        "docs/reject-codes.md": documents.rejects_page(),
        "docs/states.md": documents.states_page(),
        "docs/timeouts.md": documents.timeouts_page(),
        "eap/configuration-sheet.md": documents.eap_sheet(parameters),
        "vectors/conversation.md": golden_page(parameters),
        "vectors/conversation.json": golden_json(parameters),
        "wireshark/hmlink.lua": lua_dissector(),
        "c/hmlink.h": c_header(),
    }
    files = {path: text.encode("utf-8") for path, text in texts.items()}
    files["vectors/eap.pcap"] = golden_pcap(parameters, eap=True)
    files["vectors/raw.pcap"] = golden_pcap(parameters, eap=False)
    program = project(parameters, sources)
    program |= solution_files(parameters, program)
    files |= {f"twincat/{path}": data for path, data in program.items()}
    files = {path: files[path] for path in sorted(files)}
    return {**files, MANIFEST_FILE_NAME: _checksum_manifest(parameters, files)}


def _checksum_manifest(parameters: PlcParameters, files: Mapping[str, bytes]) -> bytes:
    """As sha256sum reads it; the first line is a comment to it."""
    head = (
        f"# HMLINK {documents.PROTOCOL_VERSION_TEXT} for {parameters.machine_name}: layout_id "
        f"{layout.LAYOUT_ID:#010x}, "
        f"cfg_id {cfg_id(parameters.limit_table):#010x}\n"
    )
    return (head + "".join(f"{hashlib.sha256(data).hexdigest()}  {path}\n" for path, data in files.items())).encode()
