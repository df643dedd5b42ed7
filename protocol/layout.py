"""Where every field lies on the wire: one table with explicit offsets; structs, layout id and documentation follow.

All little endian. The order makes natural alignment and packing the same, so pack_mode on the PLC does not matter
(a test asks ctypes).
"""

import hashlib
import struct
from dataclasses import dataclass

N_AXIS_SLOTS = 8
KNOTS_PER_COMMAND = 6
HEADER_SIZE = 32
KNOT_SIZE = 200
COMMAND_SIZE = 1304
STATE_SIZE = 568
VERSION_MAJOR = 1
VERSION_MINOR = 1  # 1.1: reject_offset, servo mode, authentication; new meaning for bytes that 1.0 called reserved
COMMAND_MAGIC = 0x31434D48  # "HMC1" in memory order
STATE_MAGIC = 0x31534D48  # "HMS1"

_CODES = {
    "USINT": ("B", 1),
    "UINT": ("H", 2),
    "UDINT": ("I", 4),
    "ULINT": ("Q", 8),
    "REAL": ("f", 4),
    "LREAL": ("d", 8),
}


@dataclass(frozen=True, slots=True)
class Field:
    """One field: byte offset in the payload (in a knot: from its first byte), IEC 61131-3 type, name, array length."""

    offset: int
    iec_type: str
    name: str
    array_length: int = 1
    first_name: str = ""  # what version 1.0 called it, where a minor version gave it a meaning

    @property
    def size(self) -> int:
        """Bytes on the wire."""
        return _CODES[self.iec_type][1] * self.array_length

    @property
    def format(self) -> str:
        """Its part of a struct format; a byte array travels as bytes."""
        if self.iec_type == "USINT" and self.array_length > 1:
            return f"{self.array_length}s"
        code = _CODES[self.iec_type][0]
        return code if self.array_length == 1 else f"{self.array_length}{code}"


@dataclass(frozen=True, slots=True)
class Block:
    """Consecutive fields; `codec` packs and unpacks them in order."""

    name: str
    fields: tuple[Field, ...]
    codec: struct.Struct

    @property
    def offset(self) -> int:
        """Byte offset of the first field."""
        return self.fields[0].offset

    def offset_of(self, name: str) -> int:
        """Byte offset of a field; raises KeyError for a name that the block does not have."""
        for field in self.fields:
            if field.name == name:
                return field.offset
        raise KeyError(f"{self.name} has no field {name}")


def _contiguous_block(name: str, end: int, *fields: Field) -> Block:
    """A block whose fields follow each other without a gap up to `end`; anything else is a mistake in the table."""
    expected = fields[0].offset
    for field in fields:
        if field.offset != expected:
            raise ValueError(
                f"layout {name}.{field.name}: offset {field.offset}, but the field before ends at {expected}"
            )
        expected += field.size
    if expected != end:
        raise ValueError(f"layout {name}: ends at {expected}, must end at {end}")
    return Block(name, fields, struct.Struct("<" + "".join(field.format for field in fields)))


# fmt: off
HEADER_LAYOUT = _contiguous_block("header", 32, Field(0, "UDINT", "magic"), Field(4, "USINT", "ver_major"),
    Field(5, "USINT", "ver_minor"), Field(6, "USINT", "msg_type"), Field(7, "USINT", "hdr_len"),
    Field(8, "UINT", "payload_len"), Field(10, "UINT", "flags"), Field(12, "UDINT", "layout_id"),
    Field(16, "UDINT", "session"), Field(20, "UDINT", "seq"), Field(24, "ULINT", "t_send_ns"))

COMMAND_BODY_LAYOUT = _contiguous_block("command", 80, Field(32, "UDINT", "arm_nonce"), Field(36, "UDINT",
    "ack_plc_seq"),
    Field(40, "ULINT", "t_plc_echo_ns"), Field(48, "UINT", "mode"), Field(50, "UINT", "axis_mask"),
    Field(52, "UDINT", "cfg_id"), Field(56, "UDINT", "traj_id"), Field(60, "UDINT", "knot_first"),
    Field(64, "USINT", "knot_count"), Field(65, "USINT", "interp"), Field(66, "UINT", "cmd_flags"),
    Field(68, "UDINT", "timeout_us"), Field(72, "LREAL", "speed_override"))

KNOT_LAYOUT = _contiguous_block("knot", KNOT_SIZE, Field(0, "ULINT", "t_ns"), Field(8, "LREAL", "q", N_AXIS_SLOTS),
    Field(72, "LREAL", "qd", N_AXIS_SLOTS), Field(136, "LREAL", "qdd", N_AXIS_SLOTS))

COMMAND_TAIL_LAYOUT = _contiguous_block("command tail", COMMAND_SIZE, Field(1280, "USINT", "auth_tag", 16),
    Field(1296, "UDINT", "reserved"), Field(1300, "UDINT", "crc"))

STATE_BODY_LAYOUT = _contiguous_block("state", STATE_SIZE, Field(32, "UDINT", "nonce"), Field(36, "UDINT", "ack_seq"),
    Field(40, "ULINT", "t_pc_echo_ns"), Field(48, "UDINT", "rx_age_us"), Field(52, "UDINT", "plc_cycle"),
    Field(56, "UINT", "plc_cycle_us"), Field(58, "USINT", "plc_state"), Field(59, "USINT", "link_state"),
    Field(60, "UINT", "mode_active"), Field(62, "UINT", "axis_mask"), Field(64, "ULINT", "fault_bits"),
    Field(72, "ULINT", "warn_bits"), Field(80, "UDINT", "cfg_id"), Field(84, "UINT", "reject_code"),
    Field(86, "UINT", "reject_count"), Field(88, "UDINT", "reject_seq"), Field(92, "UDINT", "traj_id"),
    Field(96, "UDINT", "knot_playing"), Field(100, "UDINT", "knot_last"), Field(104, "ULINT", "t_play_ns"),
    Field(112, "UDINT", "buffer_us"), Field(116, "UDINT", "underruns"), Field(120, "UDINT", "rx_ok"),
    Field(124, "UDINT", "rx_lost"), Field(128, "UDINT", "rx_dup"), Field(132, "UDINT", "rx_late"),
    Field(136, "UDINT", "rx_bad"), Field(140, "UDINT", "wd_trips"), Field(144, "LREAL", "q", N_AXIS_SLOTS),
    Field(208, "LREAL", "qd", N_AXIS_SLOTS), Field(272, "LREAL", "q_ref", N_AXIS_SLOTS), Field(336, "LREAL", "qd_ref",
        N_AXIS_SLOTS),
    Field(400, "REAL", "valve_cmd", N_AXIS_SLOTS), Field(432, "REAL", "p_a", N_AXIS_SLOTS), Field(464, "REAL", "p_b",
        N_AXIS_SLOTS),
    Field(496, "UDINT", "axis_status", N_AXIS_SLOTS), Field(528, "REAL", "p_supply"), Field(532, "REAL", "p_tank"),
    Field(536, "REAL", "t_oil"), Field(540, "REAL", "speed_scale"), Field(544, "USINT", "auth_tag", 16),
    Field(560, "UDINT", "reject_offset", first_name="reserved"), Field(564, "UDINT", "crc"))

LIMIT_TABLE_LAYOUT = _contiguous_block("limits", 288, Field(0, "UDINT", "n_axes"), Field(4, "UDINT", "reserved"),
    Field(8, "ULINT", "spacing_min_ns"), Field(16, "ULINT", "spacing_max_ns"), Field(24, "LREAL", "start_tolerance"),
    Field(32, "LREAL", "q_min", N_AXIS_SLOTS), Field(96, "LREAL", "q_max", N_AXIS_SLOTS), Field(160, "LREAL", "qd_max",
        N_AXIS_SLOTS),
    Field(224, "LREAL", "qdd_max", N_AXIS_SLOTS))  # never sent: what cfg_id is the CRC-32 of
# fmt: on

MESSAGE_BLOCK_LAYOUTS = (HEADER_LAYOUT, COMMAND_BODY_LAYOUT, KNOT_LAYOUT, COMMAND_TAIL_LAYOUT, STATE_BODY_LAYOUT)


def _schema_text() -> str:
    """The canonical text of the layout: its hash names the layout, so any change of a field changes the id.

    A minor version may give reserved bytes a meaning; it leaves sizes, offsets and so this text as they are.
    """
    lines = [
        f"HMLINK {VERSION_MAJOR} axes {N_AXIS_SLOTS} knots {KNOTS_PER_COMMAND} command {COMMAND_SIZE} state "
        f"{STATE_SIZE}"
    ]
    for block in MESSAGE_BLOCK_LAYOUTS:
        lines += [
            f"{block.name} {f.offset} {f.iec_type}[{f.array_length}] {f.first_name or f.name}" for f in block.fields
        ]
    return "\n".join(lines) + "\n"


SCHEMA_TEXT = _schema_text()
LAYOUT_ID = int.from_bytes(hashlib.sha256(SCHEMA_TEXT.encode("ascii")).digest()[:4], "little")


def offsets_markdown(block: Block) -> str:
    """One block as a documentation table."""
    rows = [
        f"| {f.offset} | {f.iec_type}{f'[{f.array_length}]' if f.array_length > 1 else ''} | {f.name} |"
        for f in block.fields
    ]
    return "\n".join(["| off | type | field |", "|---|---|---|", *rows])


_COMMAND_FIELDS = (*HEADER_LAYOUT.fields, *COMMAND_BODY_LAYOUT.fields, *COMMAND_TAIL_LAYOUT.fields)
KNOTS_OFFSET = 80


def _element_at_offset(fields: tuple[Field, ...], offset: int) -> tuple[str, str, int] | None:
    """Name with index, IEC type and start of the element that covers a byte."""
    for field in fields:
        if field.offset <= offset < field.offset + field.size:
            size = field.size // field.array_length
            i = (offset - field.offset) // size
            return (
                f"{field.name}[{i}]" if field.array_length > 1 else field.name,
                field.iec_type,
                field.offset + i * size,
            )
    return None


def command_field_at(offset: int) -> tuple[str, str, int] | None:
    """Name, IEC type and start of the command's field that covers a byte; None where there is none."""
    if KNOTS_OFFSET <= offset < COMMAND_TAIL_LAYOUT.offset:
        k, within = divmod(offset - KNOTS_OFFSET, KNOT_SIZE)
        found = _element_at_offset(KNOT_LAYOUT.fields, within)
        return (f"knot[{k}].{found[0]}", found[1], KNOTS_OFFSET + k * KNOT_SIZE + found[2]) if found else None
    return _element_at_offset(_COMMAND_FIELDS, offset)


def command_field_text(payload: bytes, offset: int) -> str:
    """`name = value` of the field at a byte of a command; empty where there is none."""
    found = command_field_at(offset) if 0 < offset < len(payload) else None
    if found is None:
        return ""
    name, iec, start = found
    code, size = _CODES[iec]
    if start + size > len(payload):
        return ""
    value = struct.unpack_from("<" + code, payload, start)[0]
    return f"{name} = {value:.6g}" if isinstance(value, float) else f"{name} = {value}"
