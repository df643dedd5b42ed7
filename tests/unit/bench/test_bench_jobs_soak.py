"""The soak of jobs: its plan of faults, its figures, its saved lines. Real processes are for the bench itself."""

import json
import os
from collections import Counter
from dataclasses import asdict

import pytest

from benchmarks.saved_lines import add_line, every_line, open_to_add
from benchmarks.server.jobs_soak.case import SoakCase, _judged
from benchmarks.server.jobs_soak.command import _thin_out
from benchmarks.server.jobs_soak.faults import SHARES, Planned, planned
from benchmarks.server.jobs_soak.figures import figures_of, line, summary
from benchmarks.server.jobs_soak.sample import MIB, growth_of, samples_of
from longreach.fleet_client import Finished
from sim_plc.camera.faults import FaultKind

WELL = Finished("done", "", {"reached": True}, 1.0)


def test_the_plan_is_the_same_every_time_and_has_every_kind():
    plans = [planned(1, number, 45.0) for number in range(1, 201)]
    assert plans == [planned(1, number, 45.0) for number in range(1, 201)]
    kinds = Counter(one.kind for one in plans)
    assert set(kinds) == set(SHARES)
    assert all(0.0 <= one.at_s <= 45.0 for one in plans)
    assert all((one.camera in {kind.value for kind in FaultKind}) == (one.kind == "camera") for one in plans)
    assert sum(SHARES.values()) == pytest.approx(1.0)


def a_case(number, t_s, rss_mib, segment=1, tasks=9.0, files=22, store=1000.0, violations=()) -> SoakCase:
    samples = [
        {"name": "server", "pid": segment, "rss_bytes": int(rss_mib * MIB), "files": files, "threads": 10},
        {"name": "link", "pid": 100 + segment, "rss_bytes": int(200 * MIB), "files": 9, "threads": 6},
    ]
    return SoakCase(
        number, segment, t_s, "none", None, ["done"], True, 50.0, 0.1, tasks, store, samples, list(violations)
    )


def hours(growth_mib_h, n=60, **changed):
    """One case a minute; the first minutes grow quickly, as caches fill."""
    cases = []
    for number in range(1, n + 1):
        filling = 50.0 * min(1.0, number / 6)
        cases.append(a_case(number, 60.0 * number, 300.0 + filling + growth_mib_h * number / 60, **changed))
    return cases


def test_growth_is_fitted_behind_the_warm_up():
    figures = figures_of(hours(1.2))
    (server, link) = figures.rss_mib
    assert server.per_hour == pytest.approx(1.2, abs=0.01)
    assert link.per_hour == 0.0
    assert figures.holds
    assert "holds" in summary(figures, "full")
    assert "QUICK" in summary(figures, "quick")


def test_memory_handles_tasks_and_violations_can_each_be_too_much():
    assert not figures_of(hours(2.5)).holds
    grown = hours(0.0)
    more_files = [a_case(c.number, c.t_s, 350.0, files=22 + c.number // 10) for c in grown]
    assert not figures_of(more_files).holds
    more_tasks = [a_case(c.number, c.t_s, 350.0, tasks=9.0 + c.number // 10) for c in grown]
    assert not figures_of(more_tasks).holds
    wrong = [*grown[:-1], a_case(60, 3600.0, 350.0, violations=["it did not return"])]
    assert not figures_of(wrong).holds
    assert "it did not return" in line(wrong[-1])


def test_the_database_is_told_per_case():
    cases = [a_case(n, 60.0 * n, 350.0, store=1000.0 * n) for n in range(1, 61)]
    assert figures_of(cases).store_bytes_per_case == pytest.approx(1000.0)


def test_a_cut_run_is_judged_by_its_longest_life():
    cases = [*hours(9.0, n=10), *hours(0.5, n=40, segment=2)]
    figures = figures_of(cases)
    assert (figures.cases, figures.segment_cases) == (50, 40)
    assert figures.rss_mib[0].per_hour == pytest.approx(0.5, abs=0.01)


def test_too_few_samples_give_no_verdict():
    assert growth_of("server", [1.0, 2.0], [3.0, 4.0]) is None
    assert not figures_of(hours(0.0, n=3)).holds


def test_saved_lines_survive_and_a_cut_one_runs_again(tmp_path):
    path = tmp_path / "1-cases.jsonl"
    cases = hours(0.0, n=3)
    with open_to_add(path) as file:
        for case in cases:
            add_line(file, asdict(case))
        file.write('{"number": 4, "segm')
    assert every_line(path, lambda text: SoakCase(**json.loads(text))) == cases


def test_only_the_last_recordings_are_kept(tmp_path):
    for number in range(9):
        (tmp_path / f"2026-{number}.mcap").touch()
    (tmp_path / "longreach.sqlite3").touch()
    _thin_out(tmp_path)
    assert sorted(path.name for path in tmp_path.glob("*.mcap")) == [f"2026-{n}.mcap" for n in range(4, 9)]
    assert (tmp_path / "longreach.sqlite3").exists()


def test_a_job_must_end_well_unless_something_was_done_to_it():
    failed, silent = Finished("failed", "no marker", None, 1.0), Finished("failed", "", None, 1.0)
    cut = Planned("cut", 3.0, 1.0)
    assert _judged(Planned("none", 0.0, 0.0), [WELL], None) == []
    assert _judged(Planned("none", 0.0, 0.0), [failed], None)
    assert _judged(Planned("bad link", 0.0, 0.0), [failed], 0.0)
    assert _judged(cut, [failed], 3.0) == []
    assert _judged(cut, [failed], None)  # it failed before the cut
    assert _judged(cut, [silent], 3.0)  # without a reason


def test_this_process_can_be_sampled():
    (own, *_) = samples_of(os.getpid(), 9)
    assert own.name == "server"
    assert own.rss_bytes > 10 * MIB
    assert own.files >= 3
    assert own.threads >= 1
