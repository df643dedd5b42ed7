"""Reference pages of the exported PLC program, generated from the protocol tables."""

from protocol import codes, layout, plc_states, timeouts
from protocol.framing import EAP_COMMAND_VARIABLE_ID, EAP_OVERHEAD_BYTES, EAP_PORT, EAP_STATE_VARIABLE_ID
from protocol.twincat.parameters import RAW_PC_PORT, RAW_PLC_PORT, PlcParameters

PROTOCOL_VERSION_TEXT = f"{layout.VERSION_MAJOR}.{layout.VERSION_MINOR}"
_BLOCKS = (
    ("Header, both directions", layout.HEADER_LAYOUT),
    ("Command (PC to PLC)", layout.COMMAND_BODY_LAYOUT),
    (f"Knot: six of them from byte {layout.KNOTS_OFFSET} on, {layout.KNOT_SIZE} bytes each", layout.KNOT_LAYOUT),
    ("End of the command", layout.COMMAND_TAIL_LAYOUT),
    ("State (PLC to PC)", layout.STATE_BODY_LAYOUT),
    ("Limits: never sent; cfg_id is the CRC-32 of these bytes, unused axes 0", layout.LIMIT_TABLE_LAYOUT),
)


def offsets_page() -> str:
    """Byte offset of every field."""
    tables = "\n\n".join(f"## {title}\n\n{layout.offsets_markdown(block)}" for title, block in _BLOCKS)
    return (
        f"# HMLINK {PROTOCOL_VERSION_TEXT}: byte offsets\n\nLittle endian, natural alignment = packing.\n\n{tables}\n"
    )


def timeouts_page() -> str:
    """Every time limit with its reason."""
    counts = (
        f"- Before ARM: {timeouts.GOOD_COMMANDS_TO_ARM} good commands.\n"
        f"- A sequence number further than {timeouts.SEQUENCE_JUMP_MAX} from the last one is refused.\n"
        f"- The ring holds {timeouts.KNOT_RING_CAPACITY} knots, {timeouts.KNOT_SPACING_MIN_NS // timeouts.MS} to "
        f"{timeouts.KNOT_SPACING_MAX_NS // timeouts.MS} ms apart.\n"
        f"- Knots nearer than {timeouts.FROZEN_KNOT_LEAD_NS // timeouts.MS} ms ahead of the playback are not replaced.\n"
    )
    return f"# HMLINK {PROTOCOL_VERSION_TEXT}: time limits\n\n{timeouts.table_markdown()}\n\n{counts}"


def states_page() -> str:
    """The state machine as a diagram."""
    return (
        f"# HMLINK {PROTOCOL_VERSION_TEXT}: states of the PLC\n\nGenerated from the table that `F_HmNextState` is generated from. "
        f"Events that change nothing are left out.\n\n```mermaid\n{plc_states.mermaid_diagram()}\n```\n\n"
        f"| Event | Meaning |\n|---|---|\n"
        + "".join(f"| {event.name} | {event.value} |\n" for event in plc_states.PlcEvent)
    )


def rejects_page() -> str:
    """Every reject code with its remedy."""
    return (
        f"# HMLINK {PROTOCOL_VERSION_TEXT}: reject codes\n\n`reject_code`, `reject_seq` and `reject_offset` of the state identify the "
        "rule, the command and its byte\n([offsets](offsets.md)); offset 0: no single field.\n\n"
        f"{codes.rejects_markdown()}\n"
    )


def eap_sheet(p: PlcParameters) -> str:
    """What to type into XAE for EAP; no file of it is generated, since no schema of Beckhoff's EDC was found."""
    version = layout.LAYOUT_ID & 0xFFFF
    rows = (
        ("Device", "EtherCAT Automation Protocol via network, on the real-time adapter of the PC link"),
        ("PLC: AMS NetId, IP", f"{p.plc_net_id}, {p.plc_address}"),
        ("PC: AMS NetId, IP", f"{p.pc_net_id}, {p.pc_address}"),
        ("UDP port", f"{EAP_PORT} at both ends (fixed by EAP)"),
        ("Subscriber: publisher", f"{p.pc_net_id}, unicast, IP addressing (UDP/IP)"),
        (
            "Subscriber variable: id, type, size",
            f"{EAP_COMMAND_VARIABLE_ID:#06x}, ST_HmCmd, {layout.COMMAND_SIZE} bytes",
        ),
        ("Subscriber: DataType Version", f"{version:#06x} ({version}); do not tick Ignore Version"),
        ("Subscriber: link of the data", "GVL_HmIo.stCmd"),
        ("Subscriber: link of Quality", "GVL_HmIo.nCmdQuality"),
        ("Subscriber: link of CycleIndex", "GVL_HmIo.nCmdCycleIndex"),
        ("Subscriber: link of VarState", "GVL_HmIo.nCmdVarState"),
        ("Publisher: target", f"{p.pc_address}, unicast, IP addressing (UDP/IP)"),
        ("Publisher variable: id, type, size", f"{EAP_STATE_VARIABLE_ID:#06x}, ST_HmState, {layout.STATE_SIZE} bytes"),
        ("Publisher: DataType Version", f"{version:#06x} ({version})"),
        ("Publisher: link of the data", "GVL_HmIo.stState"),
        ("Publisher: cycle", f"{timeouts.STATE_PERIOD.duration_ns // timeouts.MS} ms"),
        ("Task cycle", f"{p.cycle_ns / 1e6:g} ms"),
        ("UDP payload of a command", f"{layout.COMMAND_SIZE + EAP_OVERHEAD_BYTES} bytes"),
        ("UDP payload of a state", f"{layout.STATE_SIZE + EAP_OVERHEAD_BYTES} bytes"),
    )
    table = "\n".join(f"| {name} | {value} |" for name, value in rows)
    return f"""\
# EAP configuration sheet

Type these into XAE. No EDC file is shipped: its schema was not found, and an invented one would be worse than none.
DataType Version is the low 16 bits of layout_id ({layout.LAYOUT_ID:#010x}): TwinCAT itself refuses another layout.

| Setting in XAE | Value |
|---|---|
{table}

## Screenshots to keep

1. the device's adapter page;
2. the subscriber, and its variable with id, version and size;
3. the publisher, its target page, and its variable with id, version and size;
4. the task that drives both;
5. the links of stCmd, stState, Quality, CycleIndex and VarState;
6. the online view: VarState 0, CycleIndex running, Quality small;
7. the same with the PC switched off: Quality rising.

## Without EAP

TF6310 or TF6311 with raw datagrams: UDP port {RAW_PLC_PORT} at the PLC, {RAW_PC_PORT} at the PC. Use FB_HmUdpTf6310 or FB_HmUdpTf6311
in MAIN.
"""
