"""Units that were mistaken: degrees, percent, millimetres, milliseconds, bar. Found and named, never converted."""

import numpy as np

from diagnosis.log.findings import Finding
from diagnosis.log.nominal import Nominal
from diagnosis.log.quality import LOG_ROWS_MIN
from diagnosis.log.tables import PlcTable, PointTable, Tables, fill_gaps, largest_finite
from diagnosis.sliding import column_of, is_joint_sliding
from machine.rotations import Array

JOINT_LIMIT_MARGIN_RAD = 0.2
# Without limits: more than a turn to either side cannot be a joint angle of an arm in radians
UNLIMITED_JOINT_MAX_RAD = 6.6
DEGREES_SUSPECTED_MIN_RAD = 3.3  # below it a value may be either
DEGREES_RATIO_RANGE = (40.0, 80.0)  # a ratio of 57.3, give or take the effects that scale signals
PERCENT_COMMAND_MIN = 1.5
SIGNIFICANT_COMMAND_MIN = 0.5  # half a full command, or half a percent, which is noise
SPIKES_MAX, BEYOND_MIN = 0.01, 3  # share of all rows, and rows, that are more than spikes
BAR_SUSPECTED_MAX_PA = 2e3  # pressures of a crane are above 1e5 Pa; 400 bar stay below
ARM_REACH_MAX_M = 60.0
POINT_SPREAD_MIN_M = 1e-3  # between points: less is one place
TIME_UNIT_FACTORS = ((1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds"))
TIME_SPAN_RATIO_MAX = 1.5  # spans of one recording differ by less, where one clock began earlier or rows are missing


def unit_findings(tables: Tables, nominal: Nominal | None) -> list[Finding]:
    """Degrees for radians, by the joint's limits, by comparison of two columns, by the speed at full command; of joints
    that slide millimetres for metres. Percent, bar, millimetres of points, milliseconds.
    """
    plc, found = tables.plc, []
    sliding = () if nominal is None else nominal.joint_slides
    found += _millisecond_findings(tables, nominal)
    for subject, pattern, values in _position_signals(tables):
        columns = [j for j in _revolute_joints(values, sliding) if _beyond_turn(values[:, j], _angle_limit(nominal, j))]
        if columns:
            found.append(_degrees_finding(subject, pattern, columns, f"reach {largest_finite(values[:, columns]):.4g}"))
        found += _slid_in_millimetres(subject, pattern, values, sliding)
    if not any(finding.code == "degrees" for finding in found) and plc is not None:
        found += _degrees_by_comparison(plc, sliding) or _degrees_by_speed(plc, nominal)
    found += [] if plc is None else _percent_findings(plc) + _pressure_unit_findings(plc)
    placed = nominal is not None and nominal.T_base_tracker is not None
    return found + [
        finding for table in (tables.static, tables.tracker) for finding in _millimetre_findings(table, placed)
    ]


def _position_signals(tables: Tables) -> list[tuple[str, str, Array]]:
    """Every signal that is a position of each joint: its file, its columns, its numbers (m, n)."""
    plc, sent, static = tables.plc, tables.sent, tables.static
    found = (
        ("plc.csv", "q_ref_{j}_rad", None if plc is None else plc.ref),
        ("plc.csv", "q_{j}_rad", None if plc is None else plc.enc),
        ("sent.csv", "q_sent_{j}_rad", None if sent is None else sent.q),
        ("static.csv", "q_{j}_rad", None if static is None else static.q),
    )
    return [(subject, pattern, values) for subject, pattern, values in found if values is not None]


def _revolute_joints(values: Array, sliding: tuple[bool, ...]) -> list[int]:
    """The joints (0-based) whose columns may be in degrees."""
    return [j for j in range(values.shape[1]) if not is_joint_sliding(sliding, j)]


def _slid_in_millimetres(subject: str, pattern: str, values: Array, sliding: tuple[bool, ...]) -> list[Finding]:
    """Strokes that no machine has in metres."""
    found = []
    for j in range(values.shape[1]):
        if is_joint_sliding(sliding, j) and _absolute_quantile_95(values[:, j]) > ARM_REACH_MAX_M:
            farthest_m = largest_finite(values[:, j])
            reach = f"{column_of(pattern, sliding, j)} reaches {farthest_m:.4g} m (limit {ARM_REACH_MAX_M:g} m)"
            found.append(
                Finding("millimetres", "fatal", subject, f"{reach}, which looks like millimetres; write metres")
            )
    return found


def _millisecond_findings(tables: Tables, nominal: Nominal | None) -> list[Finding]:
    """Times of the PLC by its cycle in the machine file, else by its segments; all others by how long the PLC's are."""
    plc = tables.plc
    if plc is None or len(plc.t_s) < LOG_ROWS_MIN:
        return []
    segments = np.array([(segment.t_start_plc_s, segment.t_end_plc_s) for segment in tables.run_info.segments])
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
    spans = [
        _looks_like(subject, column, _span_s(table.t_s), span_s, "plc.csv spans")
        for subject, column, table in others
        if table is not None and not own
    ]
    return own + [finding for found in spans for finding in found]


def _span_s(t_s: Array) -> float:
    finite = t_s[np.isfinite(t_s)]
    return float(np.ptp(finite)) if finite.size else 0.0


def _looks_like(subject: str, column: str, span_s: float, wanted_s: float, who: str) -> list[Finding]:
    for times, unit in TIME_UNIT_FACTORS:
        if wanted_s > 0.0 and times / TIME_SPAN_RATIO_MAX < span_s / wanted_s < times * TIME_SPAN_RATIO_MAX:
            why = f"spans {span_s:.4g} s where {who} {wanted_s:.4g} s"
            return [Finding("milliseconds", "fatal", subject, f"{column} {why}: this looks like {unit}; write seconds")]
    return []


def _angle_limit(nominal: Nominal | None, j: int) -> float:
    if nominal is None or j >= nominal.n or not np.isfinite(nominal.q_min[j]) or not np.isfinite(nominal.q_max[j]):
        return UNLIMITED_JOINT_MAX_RAD
    return float(max(abs(nominal.q_min[j]), abs(nominal.q_max[j]))) + JOINT_LIMIT_MARGIN_RAD


def _beyond_turn(values: Array, limit: float) -> bool:
    """Too large for radians, and right for degrees."""
    high = _absolute_quantile_95(values)
    return high > max(limit, DEGREES_SUSPECTED_MIN_RAD) and np.deg2rad(high) <= limit


def _absolute_quantile_95(values: Array) -> float:
    """How far a column (m,) reaches, but for a few rows; 0 without any number."""
    finite = np.abs(values[np.isfinite(values)])
    return float(np.quantile(finite, 0.95)) if len(finite) else 0.0


def _degrees_finding(subject: str, pattern: str, columns: list[int], why: str) -> Finding:
    names = ", ".join(pattern.replace("{j}", str(j + 1)) for j in columns)
    return Finding("degrees", "fatal", subject, f"{names} {why}: these look like degrees; write radians", len(columns))


def _degrees_by_comparison(plc: PlcTable, sliding: tuple[bool, ...]) -> list[Finding]:
    if plc.ref is None or plc.enc is None:
        return []
    spans = [np.ptp(fill_gaps(x), axis=0) for x in (plc.ref, plc.enc)]
    findings = []
    for pattern, mine, other in (("q_ref_{j}_rad", *spans), ("q_{j}_rad", *spans[::-1])):
        turning = [j for j in _revolute_joints(plc.ref, sliding) if other[j] > 1e-6]
        columns = [j for j in turning if DEGREES_RATIO_RANGE[0] < mine[j] / other[j] < DEGREES_RATIO_RANGE[1]]
        if columns:
            ratio = float(np.median(mine[columns] / other[columns]))
            findings.append(
                _degrees_finding("plc.csv", pattern, columns, f"move {ratio:.3g} times as far as their counterpart")
            )
    return findings


def _degrees_by_speed(plc: PlcTable, nominal: Nominal | None) -> list[Finding]:
    if plc.u is None or plc.enc is None or nominal is None or nominal.actuators is None:
        return []
    if plc.enc.shape[1] != nominal.actuators.n:
        return []
    gains = measured_gains(plc.t_s, plc.enc, plc.u) / nominal.actuators.joints[:, 0]
    columns = [
        j
        for j in _revolute_joints(plc.enc, nominal.joint_slides)
        if DEGREES_RATIO_RANGE[0] < gains[j] < DEGREES_RATIO_RANGE[1]
    ]
    return (
        [_degrees_finding("plc.csv", "q_{j}_rad", columns, "move 57 times as fast as nominal at the same command")]
        if columns
        else []
    )


def measured_gains(t_s: Array, enc: Array, u: Array) -> Array:
    """Speed at full command of each joint (n,) [rad/s], by regression of speed on command; NaN without motion."""
    steps = np.diff(t_s)
    good = steps > 0.0
    both = (np.isfinite(enc[1:]) & np.isfinite(enc[:-1]) & np.isfinite(u[1:]) & np.isfinite(u[:-1]))[good]
    qd = np.diff(fill_gaps(enc), axis=0)[good] / steps[good, None]
    between = 0.5 * (fill_gaps(u)[1:] + fill_gaps(u)[:-1])[good]
    power = np.where(both, between**2, 0.0).sum(axis=0)
    return np.where(
        power > 1e-6, np.where(both, qd * between, 0.0).sum(axis=0) / np.where(power > 0.0, power, 1.0), np.nan
    )


def _percent_findings(plc: PlcTable) -> list[Finding]:
    """Columns of commands in percent, and single commands beyond the full one, which are no unit's fault.

    Model: in percent most commands that are anything are above 1.5; as fractions none is, but for spikes.
    """
    if plc.u is None:
        return []
    findings = []
    for j, column in enumerate(plc.u.T):
        u = np.abs(column[np.isfinite(column)])
        beyond = int((u > PERCENT_COMMAND_MIN).sum())
        if not beyond:
            continue
        reach = f"u_{j + 1}_frac reaches {u.max():.3g}, beyond full command 1"
        if beyond >= max(SPIKES_MAX * len(u), BEYOND_MIN) and 2 * beyond > int((u > SIGNIFICANT_COMMAND_MIN).sum()):
            text = f"{reach}; a column in percent is to be divided by 100"
            findings.append(Finding("percent", "fatal", "plc.csv", text, beyond))
        else:
            text = f"{reach}, in {beyond} of {len(u)} rows; taken as written: look where these commands come from"
            findings.append(Finding("beyond_full", "note", "plc.csv", text, beyond))
    return findings


def _pressure_unit_findings(plc: PlcTable) -> list[Finding]:
    findings = []
    for name, values in (("p_supply_pa", plc.p_supply), ("p_a_<j>_pa", plc.p_a), ("p_b_<j>_pa", plc.p_b)):
        if values is not None and 1.0 < largest_finite(values) < BAR_SUSPECTED_MAX_PA:
            text = f"{name} is at most {largest_finite(values):.4g} Pa, which looks like bar; multiply by 1e5"
            findings.append(Finding("bar", "problem", "plc.csv", text))
    return findings


def _millimetre_findings(table: PointTable | None, placed: bool) -> list[Finding]:
    """Points farther away than an arm reaches. `placed`: whether the tracker's frame is known in the base's.

    Without it the tracker may stand anywhere and count in a town's coordinates: only how far the points lie apart says
    how large the arm is. Points in one place alone lie nowhere apart, and are taken as seen from the base.
    """
    if table is None or not np.isfinite(table.xyz).any():
        return []
    spread = 0.0 if placed else _spread_m(table.xyz)
    most = spread if spread > POINT_SPREAD_MIN_M else largest_finite(table.xyz)
    if most < ARM_REACH_MAX_M:
        return []
    subject = "static.csv" if table.q is not None else "tracker.csv"
    lie = "lie up to {:.4g} m from their middle" if spread > POINT_SPREAD_MIN_M else "lie up to {:.4g} m away"
    text = f"points {lie.format(most)} (limit {ARM_REACH_MAX_M:g} m), which looks like millimetres; write metres"
    return [Finding("millimetres", "fatal", subject, text)]


def _spread_m(xyz: Array) -> float:
    """How far points (m, 3) lie from their middle, but for a few; where a prism was lost, zeros are no points."""
    good = xyz[np.isfinite(xyz).all(axis=1) & (xyz != 0.0).any(axis=1)]
    if not len(good):
        return 0.0
    return float(np.quantile(np.linalg.norm(good - np.median(good, axis=0), axis=1), 0.95))
