"""Step: both ends hold the same limits, by their hash."""

import math

from protocol.limits import LimitTable, cfg_id, limits_of
from server.commissioning.contracts import ReportTable, StepResult, Verdict, cannot_tell
from server.commissioning.site import Site

NAME = "limits equal"
_COLUMNS = (("Q_MIN", "q_min"), ("Q_MAX", "q_max"), ("QD_MAX", "qd_max"), ("QDD_MAX", "qdd_max"))


async def limits_equal(site: Site) -> StepResult:
    """Compare the PLC's cfg_id with ours; on a difference show our table to compare with GVL_HmMachine."""
    table, theirs = limits_of(site.machine.joints), site.link.health.cfg_id
    return compare_limits(table, theirs)


def compare_limits(table: LimitTable, plc_cfg_id: int) -> StepResult:
    """The result for our table and the PLC's hash; 0: the PLC told none."""
    ours = cfg_id(table)
    if plc_cfg_id == 0:
        return cannot_tell(
            NAME, "the PLC reported no cfg_id (0)", "let the PLC compute it at start-up (FB_HmSelfCheck)"
        )
    if plc_cfg_id == ours:
        return StepResult(NAME, Verdict.PASS, f"cfg_id {ours:#010x} on both ends")
    return StepResult(
        NAME,
        Verdict.FAIL,
        f"cfg_id of the PLC {plc_cfg_id:#010x}, ours {ours:#010x}: the limits differ, and the PLC refuses HELLO",
        remedy="compare the table with GVL_HmMachine; the machine file is the source: export again and load it",
        tables=(limits_table(table),),
    )


def limits_table(table: LimitTable) -> ReportTable:
    """Our limits with the names that GVL_HmMachine has for them."""
    rows = [
        (
            axis.name,
            *(f"{getattr(axis, field)!r} ({math.degrees(getattr(axis, field)):.6g} deg)" for _, field in _COLUMNS),
        )
        for axis in table.axes
    ]
    shared = f"{table.spacing_min_ns} .. {table.spacing_max_ns} ns, start tolerance {table.start_tolerance_rad!r} rad"
    return ReportTable(f"our limits [rad, s]; knots {shared}", ("axis", *(name for name, _ in _COLUMNS)), tuple(rows))
