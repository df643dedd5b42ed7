"""Columns under each other's names, signs that change while recording, points in another frame or in a mirror."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosis_cases import MACHINE_TOML, changed, recording
from static_points import POINTS, TRACKER, examined, packed, static_recording

from diagnosis.log.pairing import pairing_findings
from diagnosis.log.tables import tables_of
from diagnosis.reading.read import examine_recording
from machine.effects.layout import ParameterSets, neutral_sets
from recording.content import Recording
from recording.rows import PlcState, StaticPoint
from recording.run import Segment

MADE = recording()
STEPS = MADE.run_info.segments[-1]


def put(values: tuple[float, ...], j: int, value: float) -> tuple[float, ...]:
    return (*values[:j], value, *values[j + 1 :])


def loops_exchanged(joints: tuple[int, ...]) -> Recording:
    def exchange(_: int, row: PlcState) -> PlcState:
        q, ref = row.q_rad, row.q_ref_rad
        for j in joints:
            q, ref = put(q, j, row.q_ref_rad[j]), put(ref, j, row.q_rad[j])
        return replace(row, q_rad=q, q_ref_rad=ref)

    return changed(MADE, PlcState, exchange)


def command_for_encoder() -> Recording:
    return changed(
        MADE,
        PlcState,
        lambda _, row: replace(row, q_rad=put(row.q_rad, 0, row.u_frac[0]), u_frac=put(row.u_frac, 0, row.q_rad[0])),
    )


def reversed_in(segment: Segment, field: str, j: int) -> Recording:
    def turn(_: int, row: PlcState) -> PlcState:
        values = getattr(row, field)
        inside = segment.t_start_plc_s <= row.t_plc_s <= segment.t_end_plc_s
        return replace(row, **{field: put(values, j, -values[j])}) if inside else row

    return changed(MADE, PlcState, turn)


@pytest.mark.parametrize(
    ("made", "code", "told"),
    [
        (loops_exchanged((0, 1, 2, 3, 4, 5)), "swapped_columns", "q_6_rad and q_ref_6_rad are exchanged"),
        (loops_exchanged((1,)), "swapped_columns", "plc.csv: q_2_rad and q_ref_2_rad are exchanged"),
        (command_for_encoder(), "swapped_columns", "q_1_rad not as u_1_frac"),
        (
            reversed_in(STEPS, "q_rad", 0),
            "reversed_column",
            "q_1_rad runs against u_1_frac in 1 of 5 segments (steps4)",
        ),
        (reversed_in(STEPS, "u_frac", 2), "reversed_column", "q_3_rad runs against u_3_frac in 1 of 5 segments"),
    ],
)
def test_it_is_named_and_nothing_is_judged(made: Recording, code: str, told: str) -> None:
    whole = examine_recording(made, Path("made_up"))
    fatal = [one for one in whole.findings if one.severity == "fatal"]
    assert fatal, whole.findings
    assert {one.code for one in fatal} == {code}
    assert any(told in str(one) for one in fatal), [str(one) for one in fatal]


def test_rows_written_twice_are_counted() -> None:
    rows = [one for row in MADE.rows for one in ((row, row) if isinstance(row, PlcState) else (row,))]
    (finding,) = [
        found
        for found in examine_recording(replace(MADE, rows=tuple(rows)), Path("twice")).findings
        if found.count == 6000
    ]
    assert finding.code == "duplicate_rows"


@pytest.mark.parametrize("period_s", [0.7, 1.3, 2.0, 3.1])
def test_a_swing_that_trails_its_reference_is_not_against_it(period_s: float) -> None:
    """Half a period later it is like its opposite."""
    tables = tables_of(MADE)
    assert tables.plc is not None
    rng = np.random.default_rng(3)
    t = tables.plc.t_s
    for _ in range(5):
        swing = np.tile(np.sin(2.0 * np.pi * t / period_s)[:, None], 6)
        enc = 0.8 * np.roll(swing, 23, axis=0) + rng.normal(0.0, 0.01, swing.shape)
        plc = replace(tables.plc, ref=swing, enc=enc, u=None)
        assert not pairing_findings(replace(tables, plc=plc))


FRAME = f"{MACHINE_TOML}{POINTS}[tracker]\nT_base_tracker = {np.linalg.inv(TRACKER).ravel().tolist()}\n"


def points(change, toml: str = FRAME) -> Recording:
    """A sound arm's static points, changed."""
    made = static_recording(neutral_sets(6), toml)
    return replace(made, rows=tuple(change(row) if isinstance(row, StaticPoint) else row for row in made.rows))


EXCHANGED = {"tip": "elbow", "elbow": "tip"}


@pytest.mark.parametrize(
    ("made", "code", "told"),
    [
        (points(lambda row: replace(row, point=EXCHANGED[row.point])), "exchanged_points", "'elbow'"),
        (points(lambda row: replace(row, x_m=-row.y_m, y_m=row.x_m)), "machine_mismatch", "turned by 90 deg"),
        (points(lambda row: replace(row, z_m=row.z_m + 1.5)), "machine_mismatch", "moved by 1.5 m"),
        (points(lambda row: replace(row, y_m=-row.y_m)), "machine_mismatch", "the other sign of y"),
    ],
    ids=["names", "turned", "moved", "mirrored"],
)
def test_points_that_are_taken_the_wrong_way_are_named(made: Recording, code: str, told: str) -> None:
    whole = examined(made)
    (finding,) = whole.findings
    assert (finding.code, finding.severity) == (code, "fatal")
    assert told in finding.text


def test_a_mirror_is_seen_without_a_frame() -> None:
    whole = examined(points(lambda row: replace(row, z_m=-row.z_m), MACHINE_TOML + POINTS))
    assert [one.code for one in whole.findings if one.severity == "fatal"] == ["machine_mismatch"]


@pytest.mark.parametrize(
    "sets", [packed("encoder_bias", 1, bias_rad=0.3), packed("base_tilt", None, tilt_rad=0.1, axis=[0.6, 0.8, 0.0])]
)
def test_a_large_fault_is_no_wrong_frame(sets: ParameterSets) -> None:
    assert not examined(static_recording(sets, FRAME)).findings
