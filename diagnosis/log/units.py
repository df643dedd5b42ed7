"""Units that were mistaken: degrees, percent, millimetres, milliseconds, bar. Found and named, never converted."""

import numpy as np

from diagnosis.log.findings import Finding
from diagnosis.log.nominal import Nominal
from diagnosis.log.quality import ROWS_MIN
from diagnosis.log.tables import PlcTable, PointTable, Tables, filled, largest
from machine.rotations import Array

LIMIT_MARGIN_RAD = 0.2
FULL_TURN_RAD = 6.6  # without limits: more than a turn to either side is no joint angle of an arm in radians
DEGREES_MIN_RAD = 3.3  # below it a value may be either
DEGREES = (40.0, 80.0)  # a ratio of 57.3, give or take the effects that scale signals
PERCENT_MIN = 1.5
BAR_MAX_PA = 2e3  # pressures of a crane are above 1e5 Pa; 400 bar stay below
ARM_MAX_M = 60.0
SECONDS = ((1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds"))
SECONDS_SHARE = 1.5  # spans of one recording differ by less, where one clock began earlier or rows are missing


def unit_findings(tables: Tables, nominal: Nominal | None) -> list[Finding]:
    """Degrees for radians, by the joint's limits, by comparison of two columns, by the speed at full command."""
    plc, found = tables.plc, []
    found += _milliseconds(tables, nominal)
    signals: list[tuple[str, str, Array]] = []
    if plc is not None:
        named = (("q_ref_{j}_rad", plc.ref), ("q_{j}_rad", plc.enc))
        signals += [("plc.csv", name, values) for name, values in named if values is not None]
    if tables.sent is not None:
        signals.append(("sent.csv", "q_sent_{j}_rad", tables.sent.q))
    if tables.static is not None and tables.static.q is not None:
        signals.append(("static.csv", "q_{j}_rad", tables.static.q))
    for subject, pattern, values in signals:
        columns = [j for j in range(values.shape[1]) if _beyond_turn(values[:, j], _limit(nominal, j))]
        if columns:
            found.append(_degrees(subject, pattern, columns, f"reach {largest(values[:, columns]):.4g}"))
    if not any(one.code == "degrees" for one in found) and plc is not None:
        found += _degrees_by_comparison(plc) or _degrees_by_speed(plc, nominal)
    found += [] if plc is None else _percent(plc) + _bar(plc)
    return found + [one for table in (tables.static, tables.tracker) for one in _millimetres(table)]


def _milliseconds(tables: Tables, nominal: Nominal | None) -> list[Finding]:
    """Times of the PLC by its cycle in the machine file, else by its segments; all others by how long the PLC's are."""
    plc = tables.plc
    if plc is None or len(plc.t_s) < ROWS_MIN:
        return []
    segments = np.array([(one.t_start_plc_s, one.t_end_plc_s) for one in tables.run.segments])
    span_s, wanted_s, who = _span_s(plc.t_s), _span_s(segments), "segments span"
    if nominal is not None and nominal.actuators is not None:
        wanted_s, who = nominal.actuators.log_cycle_s * (len(plc.t_s) - 1), "its rows at the machine file's cycle span"
    own = _looks_like("plc.csv", "t_plc_s", span_s, wanted_s, who)
    others = (
        ("sent.csv", "t_pc_s", tables.sent),
        ("markers.csv", "t_camera_s", tables.markers),
        ("odometry.csv", "t_camera_s", tables.odometry),
        ("tracker.csv", "t_plc_s", tables.tracker),
    )
    beside = [
        _looks_like(subject, column, _span_s(table.t_s), span_s, "plc.csv spans")
        for subject, column, table in others
        if table is not None and not own
    ]
    return own + [one for found in beside for one in found]


def _span_s(t_s: Array) -> float:
    finite = t_s[np.isfinite(t_s)]
    return float(np.ptp(finite)) if finite.size else 0.0


def _looks_like(subject: str, column: str, span_s: float, wanted_s: float, who: str) -> list[Finding]:
    for times, unit in SECONDS:
        if wanted_s > 0.0 and times / SECONDS_SHARE < span_s / wanted_s < times * SECONDS_SHARE:
            why = f"spans {span_s:.4g} s where {who} {wanted_s:.4g} s"
            return [Finding("milliseconds", "fatal", subject, f"{column} {why}: this looks like {unit}; write seconds")]
    return []


def _limit(nominal: Nominal | None, j: int) -> float:
    if nominal is None or j >= nominal.n or not np.isfinite(nominal.q_min[j]) or not np.isfinite(nominal.q_max[j]):
        return FULL_TURN_RAD
    return float(max(abs(nominal.q_min[j]), abs(nominal.q_max[j]))) + LIMIT_MARGIN_RAD


def _beyond_turn(values: Array, limit: float) -> bool:
    """Too large for radians, and right for degrees."""
    finite = np.abs(values[np.isfinite(values)])
    if len(finite) == 0:
        return False
    high = float(np.quantile(finite, 0.95))
    return high > max(limit, DEGREES_MIN_RAD) and np.deg2rad(high) <= limit


def _degrees(subject: str, pattern: str, columns: list[int], why: str) -> Finding:
    names = ", ".join(pattern.replace("{j}", str(j + 1)) for j in columns)
    return Finding("degrees", "fatal", subject, f"{names} {why}: these look like degrees; write radians", len(columns))


def _degrees_by_comparison(plc: PlcTable) -> list[Finding]:
    if plc.ref is None or plc.enc is None:
        return []
    spans = [np.ptp(filled(x), axis=0) for x in (plc.ref, plc.enc)]
    findings = []
    for pattern, mine, other in (("q_ref_{j}_rad", *spans), ("q_{j}_rad", *spans[::-1])):
        columns = [j for j in range(len(mine)) if other[j] > 1e-6 and DEGREES[0] < mine[j] / other[j] < DEGREES[1]]
        if columns:
            ratio = float(np.median(mine[columns] / other[columns]))
            findings.append(
                _degrees("plc.csv", pattern, columns, f"move {ratio:.3g} times as far as their counterpart")
            )
    return findings


def _degrees_by_speed(plc: PlcTable, nominal: Nominal | None) -> list[Finding]:
    if plc.u is None or plc.enc is None or nominal is None or nominal.actuators is None:
        return []
    if plc.enc.shape[1] != nominal.actuators.n:
        return []
    gains = measured_gains(plc.t_s, plc.enc, plc.u) / nominal.actuators.joints[:, 0]
    columns = [int(j) for j in np.nonzero((gains > DEGREES[0]) & (gains < DEGREES[1]))[0]]
    return (
        [_degrees("plc.csv", "q_{j}_rad", columns, "move 57 times as fast as nominal at the same command")]
        if columns
        else []
    )


def measured_gains(t_s: Array, enc: Array, u: Array) -> Array:
    """Speed at full command of each joint (n,) [rad/s], by regression of speed on command; NaN without motion."""
    steps = np.diff(t_s)
    good = steps > 0.0
    both = (np.isfinite(enc[1:]) & np.isfinite(enc[:-1]) & np.isfinite(u[1:]) & np.isfinite(u[:-1]))[good]
    qd = np.diff(filled(enc), axis=0)[good] / steps[good, None]
    between = 0.5 * (filled(u)[1:] + filled(u)[:-1])[good]
    power = np.where(both, between**2, 0.0).sum(axis=0)
    return np.where(
        power > 1e-6, np.where(both, qd * between, 0.0).sum(axis=0) / np.where(power > 0.0, power, 1.0), np.nan
    )


def _percent(plc: PlcTable) -> list[Finding]:
    if plc.u is None:
        return []
    most = largest(plc.u)
    if most <= PERCENT_MIN:
        return []
    text = f"u reaches {most:.3g}, beyond full command 1; a column in percent is to be divided by 100"
    return [Finding("percent", "fatal", "plc.csv", text)]


def _bar(plc: PlcTable) -> list[Finding]:
    findings = []
    for name, values in (("p_supply_pa", plc.p_supply), ("p_a_<j>_pa", plc.p_a), ("p_b_<j>_pa", plc.p_b)):
        if values is not None and 1.0 < largest(values) < BAR_MAX_PA:
            text = f"{name} is at most {largest(values):.4g} Pa, which looks like bar; multiply by 1e5"
            findings.append(Finding("bar", "problem", "plc.csv", text))
    return findings


def _millimetres(table: PointTable | None) -> list[Finding]:
    if table is None or not np.isfinite(table.xyz).any():
        return []
    most = largest(table.xyz)
    if most < ARM_MAX_M:
        return []
    subject = "static.csv" if table.q is not None else "tracker.csv"
    text = f"points lie up to {most:.4g} m away (limit {ARM_MAX_M:g} m), which looks like millimetres; write metres"
    return [Finding("millimetres", "fatal", subject, text)]
