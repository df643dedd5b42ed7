"""Reading a recording for diagnosis: a sound one gives no finding, a spoilt one a named finding and no traceback."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosis_cases import MACHINE_TOML, OFFSET_S, PLANT, changed, folder, permuted, recording

from diagnosis.log.findings import CODES, by_channel
from diagnosis.reading.read import Read, examine_recording, read_for_diagnosis, stages_present
from recording.content import Recording
from recording.convert import write_mcap
from recording.rows import NAN, MarkerCorners, PlcState, Row, Sent, StaticPoint
from recording.run import Segment

MADE = recording()


def hunting(k: int) -> float:
    """A joint's swing [rad] in row k, back and forth every 0.2 s."""
    return 0.02 * (-1) ** (k // 20)


def codes(result: Read, *severities: str) -> set[str]:
    return {one.code for one in result.findings if not severities or one.severity in severities}


def test_a_sound_recording_has_no_findings_and_its_stages(tmp_path) -> None:
    result = read_for_diagnosis(folder(tmp_path, MADE))
    assert result.findings == ()
    assert result.has_judgeable_stage
    assert stages_present(result) == ("link", "controller", "actuator")
    assert [one.name for one in result.stretches] == ["repeat0", "repeat1", "repeat2", "repeat3", "steps4"]
    first = result.stretches[0]
    assert first.dt_s == pytest.approx(0.01)
    assert first.ref is not None
    assert first.u is not None
    assert first.sent_reference is not None
    assert first.sent_reference.t_s[0] == pytest.approx(0.0)  # PLC's clock
    assert first.row_count == 1200


def test_mcap_reads_the_same(tmp_path) -> None:
    """A hole in both, told of the channel in the one and of the file in the other."""
    made = drop(MADE, 300, 340)
    write_mcap(made, tmp_path / "run.mcap")
    one, two = read_for_diagnosis(tmp_path / "run.mcap"), read_for_diagnosis(folder(tmp_path, made))
    assert one.findings == tuple(by_channel(finding) for finding in two.findings)
    assert ("/plc", "plc.csv") in {(a.subject, b.subject) for a, b in zip(one.findings, two.findings, strict=True)}
    for a, b in zip(one.stretches, two.stretches, strict=True):
        assert np.array_equal(a.enc, b.enc)


def examined(made: Recording) -> Read:
    return examine_recording(made, Path("made_up"))


def drop(made, first: int, last: int):
    return changed(made, PlcState, lambda k, row: None if first <= k < last else row)


def degrees(values: tuple[float, ...], j: int | None = None) -> tuple[float, ...]:
    return tuple(float(np.rad2deg(x)) if j in (None, i) else x for i, x in enumerate(values))


def with_q(row: PlcState, change) -> PlcState:
    return replace(row, q_rad=change(row.q_rad))


def segmented(*segments: Segment) -> Recording:
    return replace(MADE, run_info=replace(MADE.run_info, segments=segments))


def added(*rows: Row) -> Recording:
    return replace(MADE, rows=(*MADE.rows, *rows))


SPOILT = {
    "gap": (lambda: drop(MADE, 300, 360), "gap", "problem", "60 rows are missing in 1 gaps, the longest 0.61 s"),
    "clock jump": (
        lambda: changed(MADE, PlcState, lambda k, row: replace(row, t_plc_s=row.t_plc_s + 0.35 * (505 <= k < 1200))),
        "clock_jump",
        "problem",
        "jumps 1 times, first by 0.35 s at 5.04",
    ),
    "clock back": (
        lambda: changed(MADE, PlcState, lambda k, row: replace(row, t_plc_s=row.t_plc_s - 0.5 * (k >= 500))),
        "time_backwards",
        "problem",
        "first by 0.49 s",
    ),
    "all joints in degrees": (
        lambda: changed(MADE, PlcState, lambda _, row: with_q(row, degrees)),
        "degrees",
        "fatal",
        "q_3_rad.* look like degrees",
    ),
    "one joint in degrees": (
        lambda: changed(MADE, PlcState, lambda _, row: with_q(row, lambda q: degrees(q, 4))),
        "degrees",
        "fatal",
        r"q_5_rad (reach|move).* look like degrees",
    ),
    "reference in degrees": (
        lambda: changed(MADE, PlcState, lambda _, row: replace(row, q_ref_rad=degrees(row.q_ref_rad))),
        "degrees",
        "fatal",
        "q_ref_2_rad",
    ),
    "sent in degrees": (
        lambda: changed(MADE, Sent, lambda _, row: replace(row, q_sent_rad=degrees(row.q_sent_rad))),
        "degrees",
        "fatal",
        "q_sent_2_rad",
    ),
    "percent": (
        lambda: changed(MADE, PlcState, lambda _, row: replace(row, u_frac=tuple(100.0 * x for x in row.u_frac))),
        "percent",
        "fatal",
        "divided by 100",
    ),
    "bar": (
        lambda: changed(MADE, PlcState, lambda _, row: replace(row, p_supply_pa=190.0)),
        "bar",
        "problem",
        "multiply by 1e5",
    ),
    "milliseconds": (
        lambda: changed(MADE, PlcState, lambda _, row: replace(row, t_plc_s=1e3 * row.t_plc_s)),
        "milliseconds",
        "fatal",
        "t_plc_s spans .* looks like milliseconds",
    ),
    "nanoseconds sent": (
        lambda: changed(MADE, Sent, lambda _, row: replace(row, t_pc_s=1e9 * row.t_pc_s)),
        "milliseconds",
        "fatal",
        "sent.csv: t_pc_s spans .* looks like nanoseconds",
    ),
    "encoders exchanged": (
        lambda: changed(MADE, PlcState, lambda _, row: with_q(row, lambda q: permuted(q, 3, 4))),
        "swapped_columns",
        "fatal",
        "joints 4 and 5 are exchanged",
    ),
    "commands exchanged": (
        lambda: changed(MADE, PlcState, lambda _, row: replace(row, u_frac=permuted(row.u_frac, 0, 1))),
        "swapped_columns",
        "fatal",
        "joints 1 and 2 are exchanged",
    ),
    "all columns of two joints exchanged": (
        lambda: changed(
            MADE,
            PlcState,
            lambda _, row: replace(
                row,
                q_rad=permuted(row.q_rad, 2, 4),
                q_ref_rad=permuted(row.q_ref_rad, 2, 4),
                u_frac=permuted(row.u_frac, 2, 4),
            ),
        ),
        "machine_mismatch",
        "problem",
        "outside its limits",
    ),
    "reversed": (
        lambda: changed(MADE, PlcState, lambda _, row: replace(row, u_frac=(-row.u_frac[0], *row.u_frac[1:]))),
        "reversed_column",
        "fatal",
        "wrong sign",
    ),
    "reversed, and hunting": (
        lambda: changed(
            MADE,
            PlcState,
            lambda k, row: replace(row, u_frac=(), q_rad=(hunting(k) - row.q_ref_rad[0], *row.q_rad[1:])),
        ),
        "reversed_column",
        "fatal",
        "q_1_rad runs against q_ref_1_rad",
    ),
    "the reference for an encoder": (
        lambda: changed(MADE, PlcState, lambda _, row: with_q(row, lambda q: (row.q_ref_rad[0], *q[1:]))),
        "copied_column",
        "fatal",
        "q_1_rad is q_ref_1_rad to the last digit in every row",
    ),
    "an encoder that stands still, no valves": (
        lambda: changed(MADE, PlcState, lambda _, row: replace(row, u_frac=(), q_rad=(0.25, *row.q_rad[1:]))),
        "constant",
        "problem",
        "q_1_rad never changes, though q_ref_1_rad goes over",
    ),
    "some nan": (
        lambda: changed(MADE, PlcState, lambda k, row: with_q(row, lambda q: (NAN, *q[1:]) if k == 100 else q)),
        "not_a_number",
        "problem",
        r"q_1_rad: 1 of 6000",
    ),
    "infinite": (
        lambda: changed(MADE, PlcState, lambda k, row: with_q(row, lambda q: (np.inf, *q[1:]) if k == 100 else q)),
        "not_a_number",
        "problem",
        r"q_1_rad: 1 of 6000",
    ),
    "a column empty": (
        lambda: changed(MADE, PlcState, lambda _, row: with_q(row, lambda q: (*q[:2], NAN, *q[3:]))),
        "missing_column",
        "problem",
        r"q_3_rad: 6000 of 6000",
    ),
    "ten samples": (lambda: drop(MADE, 10, 10000), "too_short", "fatal", "10 rows over 0.09 s"),
    "a dead encoder": (
        lambda: changed(MADE, PlcState, lambda _, row: with_q(row, lambda q: (0.3, *q[1:]))),
        "constant",
        "problem",
        "q_1_rad never changes",
    ),
    "no repeats": (
        lambda: replace(MADE, run_info=replace(MADE.run_info, segments=MADE.run_info.segments[-1:])),
        "no_repeats",
        "problem",
        "noise floor is not known",
    ),
    "two repeats": (
        lambda: replace(MADE, run_info=replace(MADE.run_info, segments=MADE.run_info.segments[:2])),
        "few_repeats",
        "note",
        "2 runs",
    ),
    "repeats that are none": (
        lambda: segmented(*MADE.run_info.segments[:4], replace(MADE.run_info.segments[4], repeat_of="A")),
        "repeats_differ",
        "problem",
        "differ by up to",
    ),
    "no segments": (lambda: replace(MADE, run_info=replace(MADE.run_info, segments=())), "no_segments", "note",
    "taken as one"),
    "a segment elsewhere": (
        lambda: segmented(*MADE.run_info.segments, replace(MADE.run_info.segments[0], t_start_plc_s=900.0,
            t_end_plc_s=960.0)),
        "empty_segment",
        "problem",
        "segment 6",
    ),
    "no clock offset": (
        lambda: replace(MADE, run_info=replace(MADE.run_info, plc_to_pc_offset_s=None)),
        "clock_offset_unknown",
        "note",
        "known but for a constant",
    ),
    "no machine file": (lambda: replace(MADE, machine_toml=""), "no_machine_file", "fatal", "--machine"),
    "machine file of another arm": (
        lambda: replace(MADE, machine_toml=MACHINE_TOML.replace("[tool]", '[[joint]]\nname = "x"\n[tool]')),
        "machine_mismatch",
        "fatal",
        "6 joints, machine.toml 7",
    ),
    "machine file is no TOML": (lambda: replace(MADE, machine_toml="[machine"), "machine_file", "fatal", "not TOML"),
    "machine file with a wrong effect": (
        lambda: replace(MADE, machine_toml=MACHINE_TOML + '\n[[effect]]\nname = "valve_deadbnd"\njoint = 1\n'),
        "machine_file",
        "fatal",
        "nearest: valve_deadband",
    ),
    "machine file with text for a number": (
        lambda: replace(MADE, machine_toml=MACHINE_TOML.replace("valve_damping = 0.7", 'valve_damping = "0.7"')),
        "machine_file",
        "fatal",
        "'0.7' is not a finite number",
    ),
    "log cycle differs": (
        lambda: replace(MADE, machine_toml=MACHINE_TOML.replace("log_cycle_s = 0.01", "log_cycle_s = 0.02")),
        "uneven_rate",
        "problem",
        "every 10 ms, machine.toml says 20 ms",
    ),
    "corners exchanged": (
        lambda: added(*(MarkerCorners(0.1 * k, "left", 1, 0, 0, 0, 9, 9, 9, 9, 0) for k in range(9))),
        "corner_order",
        "fatal",
        "do not run clockwise",
    ),
    "millimetres": (
        lambda: added(*(StaticPoint(k, (0.1,) * 6, "tip", 3000.0, 100.0, 2000.0) for k in range(9))),
        "millimetres",
        "fatal",
        "looks like millimetres",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SPOILT)
def test_what_is_wrong_is_found_and_named(name: str) -> None:
    spoil, code, severity, text = SPOILT[name]
    result = examined(spoil())
    found = [one for one in result.findings if one.code == code and one.severity == severity]
    assert found, [str(one) for one in result.findings]
    assert any(re.search(text, str(one)) for one in found), [str(one) for one in found]
    assert codes(result) <= set(CODES)
    assert result.has_judgeable_stage == (severity != "fatal")


@pytest.mark.parametrize(
    ("file", "old", "new", "code", "text"),
    [
        ("plc.csv", "q_2_rad,", "q_2_deg,", "unknown_column", "'q_2_deg' was not read; did you mean 'q_2_rad'"),
        ("plc.csv", "q_2_rad,", "q_2_deg,", "missing_column", "'q_2_rad' is missing between its neighbours"),
        ("plc.csv", "t_plc_s", "time", "missing_column", "'t_plc_s' is missing"),
        ("run.toml", "format_version = 1", "format_version = 9", "format_version", "this program reads 1..1"),
        ("run.toml", "format_version = 1", "format_version = 0", "format_version", "this program reads 1..1"),
        ("run.toml", 'kind = "steps"', 'kind = "jogs"', "unreadable", "one of repeat"),
        ("run.toml", "[run]", "[run", "unreadable", "not TOML"),
    ],
)
def test_spoilt_text_is_named(tmp_path, file: str, old: str, new: str, code: str, text: str) -> None:
    path = folder(tmp_path, recording(("steps",)))
    content = (path / file).read_text(encoding="utf-8")
    assert old in content
    (path / file).write_text(content.replace(old, new, 1), encoding="utf-8")
    result = read_for_diagnosis(path)
    assert any(one.code == code and text in str(one) for one in result.findings), [str(one) for one in result.findings]
    assert not result.has_judgeable_stage


@pytest.mark.parametrize(
    ("spoil", "code", "text"),
    [
        (lambda text: text.replace(",", ";").replace(".", ","), "unreadable", "columns are separated by semicolons"),
        (lambda text: text.replace(",", "\t"), "unreadable", "columns are separated by tabs"),
        (lambda text: re.sub(r"(\d)\.", r"\1,", text), "unreadable", "cells under"),
        (lambda text: re.sub(r"\n([\d.]+)\.(\d+),", r'\n"\1,\2",', text), "unreadable", "write a point, not a comma"),
    ],
)  # fmt: skip
def test_a_spreadsheets_export_is_named(tmp_path, spoil, code: str, text: str) -> None:
    path = folder(tmp_path, recording(("steps",)))
    content = (path / "plc.csv").read_text(encoding="utf-8")
    (path / "plc.csv").write_text(spoil(content), encoding="utf-8")
    result = read_for_diagnosis(path)
    assert [one.code for one in result.findings] == [code], [str(one) for one in result.findings]
    assert text in str(result.findings[0])
    (path / "plc.csv").write_text(content.split("\n")[0] + "\n", encoding="utf-8")
    assert any(found.code == "no_rows" and found.severity == "problem" for found in read_for_diagnosis(path).findings)


def test_a_missing_run_or_a_text_cell_is_a_finding(tmp_path) -> None:
    assert codes(read_for_diagnosis(tmp_path / "nowhere.mcap")) == {"unreadable"}
    assert codes(read_for_diagnosis(tmp_path)) == {"unreadable"}
    path = folder(tmp_path, recording(("steps",)))
    lines = (path / "plc.csv").read_text(encoding="utf-8").splitlines()
    lines[5] = lines[5].replace(lines[5].split(",")[3], "broken", 1)
    (path / "plc.csv").write_text("\n".join(lines), encoding="utf-8")
    assert any("line 6" in str(one) for one in read_for_diagnosis(path).findings)


def test_a_broken_log_is_cut_and_its_pieces_are_even() -> None:
    result = examined(drop(MADE, 500, 560))
    names = [one.name for one in result.stretches]
    assert names[:3] == ["repeat0/1", "repeat0/2", "repeat1"]
    assert [stretch.row_count for stretch in result.stretches[:2]] == [500, 640]
    for one in result.stretches:
        assert np.ptp(np.diff(one.t_s)) < 1e-9


def test_jitter_is_resampled_and_long_runs_of_nan_cut() -> None:
    rng = np.random.default_rng(3)
    shift = rng.uniform(-0.002, 0.002, 6000)
    shaken = changed(MADE, PlcState, lambda k, row: replace(row, t_plc_s=row.t_plc_s + shift[k]))
    smooth, exact = examined(shaken).stretches[0], examined(MADE).stretches[0]
    assert smooth.enc is not None
    assert exact.enc is not None
    assert np.ptp(np.diff(smooth.t_s)) < 1e-9
    wanted = np.interp(smooth.t_s[5:-5], exact.t_s, exact.enc[:, 5])
    assert smooth.enc[5:-5, 5] == pytest.approx(wanted, abs=1e-3)  # stamps are wrong by 2 ms, at 0.4 rad/s
    holes = changed(MADE, PlcState, lambda k, row: with_q(row, lambda q: (NAN, *q[1:]) if 400 <= k < 420 else q))
    assert [stretch.row_count for stretch in examined(holes).stretches[:2]] == [400, 780]


def test_parts_of_the_chain_are_enough() -> None:
    """Without sent references, without commands, without dynamics: what is left is judged, what is missing is named."""
    cases = {
        "no sent": (changed(MADE, Sent, lambda *_: None), ("controller", "actuator")),
        "no u": (
            changed(MADE, PlcState, lambda _, row: replace(row, u_frac=())),
            ("link", "actuator"),
        ),  # the loop as one
        "no ref": (
            changed(MADE, PlcState, lambda _, row: replace(row, q_ref_rad=())),
            ("link", "controller", "actuator"),
        ),
        "no ref, no numbers": (
            changed(MADE, PlcState, lambda _, row: replace(row, q_ref_rad=(), seq_received=-1)),
            ("actuator",),
        ),
    }
    for name, (made, stages) in cases.items():
        result = examined(made)
        assert stages_present(result) == stages, name
        assert result.has_judgeable_stage
    lean = MACHINE_TOML.replace("kp_frac_per_rad", "# kp_frac_per_rad")
    result = examined(replace(MADE, machine_toml=lean))
    assert stages_present(result) == ("link", "actuator")
    assert result.nominal_machine is not None
    assert "has no kp_frac_per_rad" in result.nominal_machine.why_absent("controller")


def test_nothing_to_judge_is_said_with_what_the_file_lacks() -> None:
    bare = '[machine]\nname = "x"\n' + "".join(f'[[joint]]\nname = "j{k}"\n' for k in range(6))
    result = examined(replace(MADE, machine_toml=bare))
    (finding,) = [one for one in result.findings if one.code == "no_data"]
    assert "joint 1 (j0) has no a_m" in str(finding)
    assert not result.has_judgeable_stage


def test_encoders_alone_say_that_what_was_asked_is_lacking() -> None:
    made = changed(MADE, PlcState, lambda _, row: replace(row, u_frac=(), q_ref_rad=()))
    result = examined(replace(made, rows=tuple(row for row in made.rows if isinstance(row, PlcState))))
    (finding,) = [one for one in result.findings if one.code == "no_data"]
    assert "not what they were asked (q_ref_<j>_rad, u_<j>_frac)" in str(finding)


def test_the_link_without_offset_is_known_but_for_a_constant() -> None:
    made = replace(MADE, run_info=replace(MADE.run_info, plc_to_pc_offset_s=None))
    sent = examined(made).stretches[0].sent_reference
    assert sent is not None
    assert sent.t_s[0] == pytest.approx(0.0, abs=PLANT.log_cycle_s)
    assert OFFSET_S > 1.0


@pytest.mark.parametrize("word", ["1e308", "-1e200", "inf", "nan", ""])
def test_absurd_numbers_are_findings(word: str, tmp_path) -> None:
    path = folder(tmp_path, recording(("steps",)))
    lines = (path / "plc.csv").read_text(encoding="utf-8").splitlines()
    place = lines[0].split(",").index("q_2_rad")
    for k in range(1, len(lines)):
        cells = lines[k].split(",")
        cells[place] = word
        lines[k] = ",".join(cells)
    (path / "plc.csv").write_text("\n".join(lines), encoding="utf-8")
    assert any(one.code == "missing_column" and "q_2_rad" in str(one) for one in read_for_diagnosis(path).findings)


def test_an_infinite_count_is_a_finding(tmp_path) -> None:
    path = folder(tmp_path, recording(("steps",)))
    lines = (path / "sent.csv").read_text(encoding="utf-8").splitlines()
    cells = lines[3].split(",")
    lines[3] = ",".join([cells[0], "inf", *cells[2:]])
    (path / "sent.csv").write_text("\n".join(lines), encoding="utf-8")
    assert codes(read_for_diagnosis(path)) == {"unreadable"}
