"""Whether the machine file describes the arm that was recorded, and whether marker corners are in order."""

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from diagnosis.log.findings import Finding
from diagnosis.log.nominal import Nominal
from diagnosis.log.tables import MarkerTable, PointTable, Tables
from diagnosis.log.units import JOINT_LIMIT_MARGIN_RAD
from diagnosis.sliding import column_of, unit_of
from machine.rotations import Array

EYES_LEAST, EYES_SHARE = 5, 0.9  # markers seen by both eyes, and how many of them have to say the same
OUTSIDE_MIN, INSIDE_MAX = 0.2, 0.01  # shares of rows outside limits: surely outside, surely inside


def machine_findings(tables: Tables, nominal: Nominal) -> list[Finding]:
    """Whether the machine file describes the arm that was recorded."""
    findings: list[Finding] = []
    if tables.joint_count and nominal.n and tables.joint_count != nominal.n:
        text = f"the recording has {tables.joint_count} joints, machine.toml {nominal.n}; use the file of this machine"
        return [Finding("machine_mismatch", "fatal", "machine.toml", text)]
    plc = tables.plc
    if plc is not None and plc.enc is not None:
        findings += _limit_findings(plc.enc, nominal)
    findings += _point_findings(tables, nominal)
    if tables.markers is not None and nominal.markers:
        known = {marker.marker_id for marker in nominal.markers}
        strange = sorted(set(tables.markers.marker_ids.tolist()) - known)
        if strange:
            text = f"markers {strange[:6]} were seen but are not in machine.toml; they are not used"
            findings.append(Finding("machine_mismatch", "note", "markers.csv", text, len(strange)))
    return findings


def _share_outside_limits(enc: Array, nominal: Nominal) -> Array:
    """Share of rows (columns, joints) in which column j lies outside joint k's limits."""
    x = enc[:, :, None]
    beyond = (x < nominal.q_min - JOINT_LIMIT_MARGIN_RAD) | (x > nominal.q_max + JOINT_LIMIT_MARGIN_RAD)
    return np.asarray((beyond & np.isfinite(x)).mean(axis=0), dtype=float)


def _limit_findings(enc: Array, nominal: Nominal) -> list[Finding]:
    shares = _share_outside_limits(enc, nominal)
    findings, reported = [], set()
    for j in range(enc.shape[1]):
        if shares[j, j] < OUTSIDE_MIN or j in reported:
            continue
        inside = (shares[j] < INSIDE_MAX) & (shares[:, j] < INSIDE_MAX) & (np.diag(shares) >= OUTSIDE_MIN)
        partner = np.nonzero(inside)[0].tolist()
        low, high = nominal.q_min[j], nominal.q_max[j]
        name, unit = column_of("q_{j}_rad", nominal.joint_slides, j), unit_of("rad", nominal.joint_slides, j)
        reach = f"{name} lies at {np.nanmin(enc[:, j]):.3g} .. {np.nanmax(enc[:, j]):.3g} {unit}"
        text = f"{reach}, outside its limits {low:.3g} .. {high:.3g} {unit}"
        if partner:
            reported.add(partner[0])
            name = nominal.joint_names[partner[0]]
            text += f", and fits joint {partner[0] + 1} ({name}) instead: the joints' order differs"
            findings.append(Finding("swapped_columns", "fatal", "plc.csv", text))
        else:
            findings.append(Finding("machine_mismatch", "problem", "plc.csv", f"{text}; check file, sign and zero"))
    return findings


def _point_findings(tables: Tables, nominal: Nominal) -> list[Finding]:
    known = {point.name for point in nominal.tracked_points}
    findings = []
    for subject, table in (("tracker.csv", tables.tracker), ("static.csv", tables.static)):
        strange = sorted(set(table.point_names) - known) if table is not None else []
        if strange:
            remedy = "give joint, and xyz_m where it is known"
            text = f"points {strange[:6]} are not in [points] of machine.toml and are not used; {remedy}"
            findings.append(Finding("machine_mismatch", "problem", subject, text, len(strange)))
        findings += _duplicate_point_findings(subject, table) if table is not None else []
    return findings


def _duplicate_point_findings(subject: str, table: PointTable) -> list[Finding]:
    """Pairs of points that were written with the same numbers: one measurement counted twice."""
    by_name: dict[str, dict[float, tuple[float, ...]]] = {}
    for t, name, xyz in zip(table.t_s.tolist(), table.point_names, table.xyz.tolist(), strict=True):
        by_name.setdefault(name, {})[t] = tuple(xyz)
    pairs = [(a, b) for a, b in combinations(sorted(by_name), 2) if by_name[a] == by_name[b]]
    return [
        Finding(
            "duplicate_points",
            "problem",
            subject,
            f"{a!r} and {b!r} have the same coordinates throughout; {b!r} is not counted: drop it, or give its own",
        )
        for a, b in pairs
    ]


def corner_findings(tables: Tables) -> list[Finding]:
    """Corners that do not run clockwise as seen in the image (OpenCV's order), and eyes without a name."""
    markers = tables.markers
    if markers is None:
        return []
    nameless = int((markers.eye < 0).sum())
    findings = []
    if nameless:
        text = f"{nameless} rows have an eye other than 'left' or 'right'; they are not used"
        findings.append(Finding("not_a_number", "problem", "markers.csv", text, nameless))
    findings += _exchanged_eyes(markers)
    wrong = _has_anticlockwise_turn(markers.corners_px[np.isfinite(markers.corners_px).all(axis=(1, 2))])
    share = float(wrong.mean()) if len(wrong) else 0.0
    if share > 0.01:
        text = (
            f"{100.0 * share:.3g} % of the markers have corners that do not run clockwise; u and v, or two corners, "
            "are exchanged"
        )
        findings.append(
            Finding("corner_order", "fatal" if share > 0.5 else "problem", "markers.csv", text, int(wrong.sum()))
        )
    return findings


def _exchanged_eyes(markers: MarkerTable) -> list[Finding]:
    """Markers that lie further left in the left eye, on the whole: nothing in front of a camera does."""
    seen: dict[tuple[float, int], dict[int, float]] = {}
    for t, number, eye, corners in zip(markers.t_s, markers.marker_ids, markers.eye, markers.corners_px, strict=True):
        seen.setdefault((float(t), int(number)), {})[int(eye)] = float(corners[:, 0].mean())
    apart = np.array([both[0] - both[1] for both in seen.values() if 0 in both and 1 in both])
    apart = apart[np.isfinite(apart)]
    if len(apart) < EYES_LEAST or np.median(apart) >= 0.0 or np.mean(apart < 0.0) < EYES_SHARE:
        return []
    text = f"markers lie {-np.median(apart):.3g} px further left in the left eye than in the right one; in front of a "
    return [Finding("eyes_exchanged", "fatal", "markers.csv", f"{text}camera none does: exchange 'left' and 'right'")]


def _has_anticlockwise_turn(corners: Array) -> NDArray[np.bool_]:
    """Whether any turn of the square is to the left in the image (v down): (m,)."""
    side = np.roll(corners, -1, axis=1) - corners
    following = np.roll(side, -1, axis=1)
    turn = side[..., 0] * following[..., 1] - side[..., 1] * following[..., 0]
    return np.asarray((turn < 0.0).any(axis=1))
