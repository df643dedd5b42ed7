"""Global constants: layout, bits, times, machine; and the variables that an engineer binds to this machine's I/O."""

from dataclasses import dataclass
from enum import IntFlag

from protocol import codes, layout, timeouts
from protocol.limits import cfg_id
from protocol.twincat.parameters import PlcParameters


@dataclass(frozen=True, slots=True)
class Gvl:
    """One global variable list."""

    name: str
    declaration: str


def gvls(parameters: PlcParameters) -> tuple[Gvl, ...]:
    """All global variable lists."""
    return (
        _constant_gvl("GVL_HmLayout", "Sizes, numbers and byte offsets of the wire.", _layout_constants()),
        _constant_gvl("GVL_HmBits", "Bits of flags, faults, warnings and axis words.", _flag_bit_constants()),
        _constant_gvl("GVL_HmTimes", "Every time limit; docs/timeouts.md gives the reasons.", _timeout_constants()),
        _constant_gvl(
            "GVL_HmMachine",
            f"Limits, gains and thresholds of {parameters.machine_name}; SI.",
            _machine_constants(parameters),
        ),
        Gvl("GVL_HmAuth", _AUTH),
        Gvl("GVL_HmIo", _IO),
    )


_QUALIFIED = "{attribute 'qualified_only'}"
_AUTH = f"""\
(* The key of the link's authentication, the same as on the PC. Length 0: nothing is signed. Fill it at start-up
   from a retained variable or a file; do not keep it in the source. *)
{_QUALIFIED}
VAR_GLOBAL
    aKey : ARRAY[0..63] OF BYTE;
    nKeyLength : UINT := 0; // 0, or 16..64
END_VAR
"""
_IO = f"""\
(* Bind these to this machine: EAP subscriber and publisher, the switches at the machine, encoders, valves. *)
{_QUALIFIED}
VAR_GLOBAL
    stCmd AT %I* : ST_HmCmd; // EAP subscriber variable 16#4801
    nCmdQuality AT %I* : UINT; // its age, 100 us
    nCmdCycleIndex AT %I* : UINT;
    nCmdVarState AT %I* : UINT; // 0: good
    stState AT %Q* : ST_HmState; // EAP publisher variable 16#4802

    bEnable AT %I* : BOOL; // enable key at the machine
    bLeverTaken AT %I* : BOOL; // a person drives by hand
    bEstop AT %I* : BOOL; // TRUE: pressed; the stop itself is hard-wired
    bPanelValid : BOOL; // TRUE while the three inputs above are read: set it in MAIN from their terminal's WcState
    stSample : ST_HmSample; // scaled readings of this cycle
    aValves : ARRAY[0..7] OF LREAL; // -1..1 to the valve outputs

    bDryRun : BOOL := TRUE; // valves stay closed until this is set FALSE by hand
END_VAR
"""
Row = tuple[str, str, str]


def _constant_gvl(name: str, purpose: str, rows: list[Row]) -> Gvl:
    body = "\n".join(f"    {row[0]} : {row[1]} := {row[2]};" for row in rows)
    return Gvl(name, f"(* {purpose} Generated: do not edit. *)\n{_QUALIFIED}\nVAR_GLOBAL CONSTANT\n{body}\nEND_VAR\n")


def _layout_constants() -> list[Row]:
    numbers = (
        ("CMD_SIZE", layout.COMMAND_SIZE),
        ("STATE_SIZE", layout.STATE_SIZE),
        ("LIMITS_SIZE", layout.LIMIT_TABLE_LAYOUT.codec.size),
        ("HEADER_SIZE", layout.HEADER_SIZE),
        ("AXES", layout.N_AXIS_SLOTS),
        ("KNOTS", layout.KNOTS_PER_COMMAND),
        ("KNOT_SIZE", layout.KNOT_SIZE),
        ("CMD_TAG", layout.COMMAND_TAIL_LAYOUT.offset_of("auth_tag")),
        ("CMD_CRC", layout.COMMAND_TAIL_LAYOUT.offset_of("crc")),
        ("STATE_TAG", layout.STATE_BODY_LAYOUT.offset_of("auth_tag")),
        ("STATE_CRC", layout.STATE_BODY_LAYOUT.offset_of("crc")),
        ("OFS_KNOTS", layout.KNOTS_OFFSET),
    )
    fields = (*layout.HEADER_LAYOUT.fields, *layout.COMMAND_BODY_LAYOUT.fields)
    return [
        ("CMD_MAGIC", "UDINT", _st_hex_literal(layout.COMMAND_MAGIC)),
        ("STATE_MAGIC", "UDINT", _st_hex_literal(layout.STATE_MAGIC)),
        ("LAYOUT_ID", "UDINT", _st_hex_literal(layout.LAYOUT_ID)),
        ("VERSION_MAJOR", "USINT", str(layout.VERSION_MAJOR)),
        ("VERSION_MINOR", "USINT", str(layout.VERSION_MINOR)),
        *((name, "UDINT", str(number)) for name, number in numbers),
        *((f"OFS_{field.name.upper()}", "UDINT", str(field.offset)) for field in fields),
        *((f"OFS_KNOT_{field.name.upper()}", "UDINT", str(field.offset)) for field in layout.KNOT_LAYOUT.fields),
    ]


def _flag_bit_constants() -> list[Row]:
    kinds: tuple[tuple[str, str, type[IntFlag]], ...] = (
        ("HDR", "UINT", codes.HeaderFlag),
        ("CMD", "UINT", codes.CommandFlag),
        ("FAULT", "ULINT", codes.FaultBit),
        ("WARN", "ULINT", codes.WarnBit),
        ("AXIS", "UDINT", codes.AxisBit),
    )
    return [(f"{prefix}_{bit.name}", iec, _st_hex_literal(int(bit))) for prefix, iec, kind in kinds for bit in kind]


def _timeout_constants() -> list[Row]:
    return [
        *((f"{t.name.upper().replace(' ', '_')}_NS", "ULINT", str(t.duration_ns)) for t in timeouts.ALL_TIMEOUTS),
        ("GOOD_COMMANDS_TO_ARM", "UDINT", str(timeouts.GOOD_COMMANDS_TO_ARM)),
        ("SEQUENCE_JUMP", "UDINT", str(timeouts.SEQUENCE_JUMP_MAX)),
        ("RING_KNOTS", "UDINT", str(timeouts.KNOT_RING_CAPACITY)),
        ("KNOT_SPACING_MIN_NS", "ULINT", str(timeouts.KNOT_SPACING_MIN_NS)),
        ("KNOT_SPACING_MAX_NS", "ULINT", str(timeouts.KNOT_SPACING_MAX_NS)),
        ("START_TOLERANCE", "LREAL", _st_real_literal(timeouts.START_TOLERANCE_RAD)),
        ("FROZEN_NS", "ULINT", str(timeouts.FROZEN_KNOT_LEAD_NS)),
        ("SERVO_REACH_S", "LREAL", _st_real_literal(timeouts.SERVO_TARGET_LEAD_MAX_S)),
    ]


def _machine_constants(p: PlcParameters) -> list[Row]:
    axes = p.limit_table.axes
    columns = (
        ("Q_MIN", [axis.q_min for axis in axes]),
        ("Q_MAX", [axis.q_max for axis in axes]),
        ("QD_MAX", [axis.qd_max for axis in axes]),
        ("QDD_MAX", [axis.qdd_max for axis in axes]),
        ("KP", p.kp_frac_per_rad),
        ("PT1_SHARE", p.pt1_share),
        ("LAG_WARN", p.lag_warn),
        ("LAG_FAULT", p.lag_fault),
    )
    scalars = (
        ("CYCLE_S", "LREAL", p.cycle_ns * 1e-9),
        ("RANGE_MARGIN", "LREAL", p.range_margin_rad),
        ("ENCODER_JUMP", "LREAL", p.encoder_jump_rad),
        ("ENCODER_JUMP_FACTOR", "LREAL", p.encoder_jump_factor),
        ("REST_SPEED", "LREAL", p.rest_speed_rad_s),
        ("SUPPLY_WARN", "REAL", p.supply_warn_pa),
        ("SUPPLY_FAULT", "REAL", p.supply_fault_pa),
        ("OIL_WARN", "REAL", p.oil_warn_c),
        ("OIL_FAULT", "REAL", p.oil_fault_c),
        ("KNOTS_ROUNDING", "LREAL", 1e-9),
        ("KNOTS_REST", "LREAL", 1e-6),
        ("KNOTS_BETWEEN", "LREAL", 1.10),
        ("FADE_SPEED_FACTOR", "LREAL", timeouts.PLAUSIBLE_SPEED_FACTOR),
    )
    return [
        ("N_AXES", "UDINT", str(len(axes))),
        ("CYCLE_NS", "ULINT", str(p.cycle_ns)),
        ("CFG_ID_EXPECTED", "UDINT", _st_hex_literal(cfg_id(p.limit_table))),
        *((name, iec, _st_real_literal(value)) for name, iec, value in scalars),
        *(
            (name, f"ARRAY[0..{layout.N_AXIS_SLOTS - 1}] OF LREAL", _st_array_literal(values))
            for name, values in columns
        ),
    ]


def _st_hex_literal(number: int) -> str:
    return f"16#{number:X}"


def _st_real_literal(value: float) -> str:
    """The shortest decimal that gives back the same double; ST wants a point before the exponent."""
    text = repr(float(value)).upper()
    mantissa, _, exponent = text.partition("E")
    mantissa = mantissa if "." in mantissa else f"{mantissa}.0"
    return f"{mantissa}E{exponent}" if exponent else mantissa


def _st_array_literal(values: tuple[float, ...] | list[float]) -> str:
    return (
        "["
        + ", ".join(_st_real_literal(value) for value in (*values, *(0.0,) * (layout.N_AXIS_SLOTS - len(values))))
        + "]"
    )
