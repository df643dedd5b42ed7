"""Saved lines that resume, cases that come back from them, tables beside the paper's, and the page."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from reproduce_worlds import NOISE, machine
from rich.console import Console

from benchmarks.reproduce.cases import Case, fast_line_run, fast_matching_run, line_case, matching_case
from benchmarks.reproduce.compose import printed_tables, saved_cases, write_report
from benchmarks.reproduce.error_series import error_series, look_times_s
from benchmarks.reproduce.fast_tables import TABLE_4_FILE, case_line, case_of, table_2_file
from benchmarks.reproduce.report import Check, page, table_html
from benchmarks.reproduce.report_tables import TableView, checks, refusals_view, table_2_view, table_4_view
from benchmarks.reproduce.true_error import StepErrors
from benchmarks.saved_lines import SavedLineError, read_lines, run_saved

QUIET = Console(quiet=True)


def step(name: str, camera_mm: tuple[float, float, float]) -> StepErrors:
    return StepErrors(
        name, camera_mm, camera_mm, camera_mm, camera_mm, 1.0, 1.0, None, (1.0, 2.0, 3.0), (1.0, 2.0, 3.0)
    )


def line(seed: int, xy: tuple[float, float]) -> Case:
    return Case(seed, "line", "done", "", (step("oriented", (9.0, 9.0, 400.0)), step("move", (*xy, 400.0))))


def test_a_run_that_was_stopped_goes_on_and_a_torn_last_line_is_run_again(tmp_path):
    path, ran = tmp_path / "a.jsonl", []

    def run(key: int) -> dict[str, int]:
        ran.append(key)
        return {"square": key * key}

    run_saved(path, range(3), run, QUIET, "squares")
    path.write_text(path.read_text(encoding="utf-8") + '{"key": 3, "squ', encoding="utf-8")
    found = run_saved(path, range(5), run, QUIET, "squares")
    assert ran == [0, 1, 2, 3, 4]
    assert [one["square"] for one in found] == [0, 1, 4, 9, 16]
    assert len(read_lines(path)) == 5
    path.write_text("no line\n" + path.read_text(encoding="utf-8"), encoding="utf-8")
    with pytest.raises(SavedLineError, match="line 1"):
        read_lines(path)


def test_a_case_comes_back_from_its_line():
    case = matching_case(machine(), 2, NOISE)
    assert case_of(json.loads(json.dumps({"key": 2, **case_line(case)}))) == case
    refused = Case(3, "x", "refused", "why")
    assert case_of(json.loads(json.dumps(case_line(refused)))) == refused


def test_table_2_has_the_papers_means_and_ours_beside_them():
    fast = {"paper servo": [line(1, (20.0, -30.0)), line(2, (-30.0, 20.0))]}
    view = table_2_view(fast, {})
    assert view.rows[0][3] == "24 / 29 / 338"
    assert view.rows[2][:4] == ("fast: as the paper", "2", "1.00 / 2.00 / 3.00", "25.0 / 25.0 / 400.0")


def test_table_4_tells_the_scatter_of_depth():
    cases = [
        Case(k, "m", "done", "", (step("move 1", (1.0, 20.0, 100.0 + k)), step("move 2", (1.0, 2.0, 100.0 - k))))
        for k in (-10, 0, 10)
    ]
    rows = {row[0]: row for row in table_4_view(cases, []).rows}
    assert rows["fast, input 1"][3] == "10.0"
    assert rows["fast, input 2"][4] == "6.7"
    assert rows["the paper, input 2"][4] == "10.8"


def test_checks_are_met_only_inside_their_bounds_and_never_without_data():
    met = {check.name: check.met for check in checks({"fit": [line(1, (7.9, 8.1)), line(2, (7.9, 8.1))]}, [])}
    assert met["Table 2, improved, fit over all looks: mean |e_X|"]
    assert not met["Table 2, improved, fit over all looks: mean |e_Y|"]
    assert not met["Table 4, input 1: mean |e_Y|"]
    assert not Check("none", float("nan"), 0.0, 1.0, "mm", 0).met


def test_refusals_of_one_kind_are_counted_together():
    cases = [Case(k, "a", "refused", f"seen in {k} of 9 pairs; look again") for k in (1, 2)] + [line(3, (1.0, 1.0))]
    row = refusals_view({"a": cases}).rows[0]
    assert row[1:3] == ("3", "1")
    assert row[3].startswith("2 x refused: seen in # of # pairs")


def test_the_page_escapes_what_it_is_given():
    view = TableView("a < b", ("<h>",), (("the paper & us",),))
    text = page("t", ["<b>"], [], [])
    assert "&lt;b&gt;" in text
    assert "<b>" not in text
    assert '<tr class="paper"><td>the paper &amp; us</td></tr>' in table_html(view)


def test_table_3s_errors_are_of_the_match_and_the_wedge_of_the_tilted_mount_shows():
    """5 deg of tilt that the match cannot see: the plane of the path is laid wrong by up to 0.2 m times 5 deg."""
    run = fast_matching_run(machine(), 2, NOISE)
    assert run.sets is not None
    mean, maximum = run.sets.at_once.mean_mm, run.sets.at_once.maximum_mm
    assert 5.0 < max(mean) < 20.0
    assert all(high >= middle for middle, high in zip(mean, maximum, strict=True))
    assert max(run.sets.nearest_point.mean_mm) <= max(mean) + 2.0
    assert run.case.notes["at once mean x"] == pytest.approx(mean[0])


def test_the_errors_over_time_end_where_the_look_saw_them():
    run = fast_matching_run(machine(), 2, NOISE)
    looks = look_times_s(run)
    assert len(looks) == 5
    series = error_series(run, looks[2] - 1.0, looks[-1])
    assert series.found.mean() > 0.9
    last = np.median(series.camera_mm[-5:], axis=0)
    np.testing.assert_allclose(last, run.case.steps[-1].camera_image_mm, atol=12.0)  # single pairs of one eye
    assert series.inputs_s[0] == pytest.approx(1.0)


def test_without_a_set_up_there_is_no_picture():
    run = fast_line_run(machine(), 2, NOISE, "paper")
    with pytest.raises(ValueError, match="choose another seed"):
        look_times_s(type(run)(Case(1, "line", "no set-up", "nowhere")))


def test_the_report_is_one_page_with_pictures_beside_it(tmp_path):
    pytest.importorskip("matplotlib")
    fast = tmp_path / "fast"
    run_saved(fast / TABLE_4_FILE, [2], lambda s: case_line(matching_case(machine(), s, NOISE)), QUIET, "4")
    run_saved(fast / table_2_file("fit"), [2], lambda s: case_line(line_case(machine(), s, NOISE, "fit")), QUIET, "2")
    path = write_report(tmp_path, machine(), NOISE, 2)
    pictures = {one.name for one in (tmp_path / "pictures").iterdir()}
    assert {f"figure{k}.{kind}" for k in range(5, 10) for kind in ("png", "svg")} <= pictures
    shutil.rmtree(tmp_path / "pictures")
    text = path.read_text(encoding="utf-8")
    assert text.count("data:image/png;base64,") == 7
    assert "http" not in text.replace("http-equiv", "")
    assert len(saved_cases(tmp_path).table_4) == 1
    assert any("Table 3" in view.title for view in printed_tables(tmp_path))
    assert isinstance(path, Path)
