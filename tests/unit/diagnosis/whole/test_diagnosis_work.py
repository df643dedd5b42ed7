"""How far a diagnosis is: the work told never runs backwards, ends where it said it would, and names make it more."""

import io
from itertools import pairwise

import pytest
from foreign_plant import Fault, write
from rich.console import Console

from diagnosis.budget import budget_of
from diagnosis.reading.read import read_for_diagnosis
from diagnosis.search.work import WorkProgress
from longreach.diagnose_command import PROGRESS_LINE_PERIOD_S, Outlook, console_progress, in_words, left_s

SEGMENTS = ("repeat", "repeat", "repeat", "repeat", "steps", "workcycle")


@pytest.mark.parametrize("fault", [Fault(), Fault(lag_s=(0.0, 0.03), length_m=0.01)])
def test_work_is_told_from_the_first_candidate_to_the_end(tmp_path, fault) -> None:
    heard: list[tuple[str, float, float]] = []
    whole = read_for_diagnosis(write(tmp_path / "run", fault, 3, seconds=6.0, kinds=SEGMENTS, tracker_m=2e-4))
    found = budget_of(whole, lambda *told: heard.append(told))
    texts, done, total = zip(*heard, strict=True)
    assert (texts[0], texts[-1]) == ("fitting structure", "held-out data")
    assert {"fitting link", "fitting controller 2", "fitting actuator 1", "weighing", "localising"} <= set(texts)
    assert all(later >= earlier for earlier, later in pairwise(done))
    assert done[0] == 0.0
    assert 0.9 < done[-1] / total[-1] <= 1.0
    assert all(part < whole for part, whole in zip(done[:-1], total, strict=False))
    assert max(total) / total[0] < 4.0
    assert found.verdict == ("none" if fault == Fault() else "effects")
    assert max(total) > total[0] or fault == Fault()  # names make it more


def test_another_fit_of_a_cell_makes_more_work_and_none_less() -> None:
    heard: list[float] = []
    work = WorkProgress(lambda _text, done, _total: heard.append(done))
    for step in (lambda: work.begin("a cell"), work.repeat_cell, work.end_cell):
        step()
    work.report_concluding_progress("weighing", 0.0)
    work.report_concluding_progress("localising", 0.85)
    assert heard == sorted(heard)


def test_the_time_left_is_by_the_speed_so_far_and_told_as_a_range() -> None:
    assert left_s(10.0, 30.0, 10.0) == pytest.approx(20.0)
    assert left_s(10.0, 30.0, 34.0) == pytest.approx(60.0)  # a computer a third as fast
    assert left_s(30.0, 30.0, 50.0) == 0.0
    told = [in_words(seconds) for seconds in (0.0, 2.0, 14.0, 70.0, 400.0)]
    assert told == [
        "a few seconds left",
        "a few seconds left",
        "10 to 30 s left",
        "45 s to 2 min left",
        "4 to 15 min left",
    ]


def test_a_share_never_goes_back_and_is_never_all_before_the_end() -> None:
    said: list[tuple[str, float]] = []
    clock = iter([0.0, 1.0, 5.0, 6.0, 20.0, 21.0])
    shown = Outlook(lambda words, done, _total: said.append((words, done)), lambda: next(clock))
    shown.on_progress("searching structure", 0.1, 10.0)
    shown.on_progress("searching structure", 5.0, 10.0)
    shown.on_progress("searching structure", 5.5, 30.0)  # a name was found
    shown.on_progress("localising", 30.0, 30.0)
    shown.report_final_step("next experiment")
    assert [share for _, share in said] == [0.01, 0.5, 0.5, 0.99, 0.99]
    assert said[0][0] == "searching structure: 1 % done, remaining time unknown"
    assert said[2][0] == "searching structure: 50 % done, 15 to 60 s left"


def test_beside_a_terminal_a_line_comes_every_few_seconds_and_none_of_a_short_one() -> None:
    stream, now = (
        io.StringIO(),
        iter(
            [
                0.0,
                PROGRESS_LINE_PERIOD_S,
                2.1 * PROGRESS_LINE_PERIOD_S,
                2.2 * PROGRESS_LINE_PERIOD_S,
                4.0 * PROGRESS_LINE_PERIOD_S,
            ]
        ),
    )
    with console_progress(Console(file=stream), now_s=lambda: next(now)) as shown:
        for share in range(1, 5):
            shown.on_progress("searching structure", share, 10.0)
    assert [line[:26] for line in stream.getvalue().splitlines()] == [
        "searching structure: 20 % ",
        "searching structure: 40 % ",
    ]
