"""The link under vision load, a few seconds of it: that every figure is there. How good they are decides no test."""

import io
import json
from dataclasses import asdict

import numpy as np
import pytest
from rich.console import Console

from benchmarks.link.load.back_and_forth import KNOT_S, back_and_forth
from benchmarks.link.load.lateness import lateness_us, percentiles
from benchmarks.link.load.minute import minute_from, total_of
from benchmarks.link.load.replay_camera import to_and_fro
from benchmarks.link.real_time import Plan, bench, line, summary
from machine.description import parse_machine_toml
from protocol.gate import check_trajectory
from protocol.limits import limits_of
from protocol.messages import Knot, pad_to_eight_axes
from server.link.samples import knots_of
from server.settings import read_machine_text

MACHINE = parse_machine_toml(read_machine_text("hiab033"))
Q_START = np.deg2rad([10.0, 40.0, -80.0, 5.0, -40.0, 3.0])
MS = 1_000_000


@pytest.mark.system
@pytest.mark.real_time
@pytest.mark.timeout(180)
@pytest.mark.parametrize("where", ["process", pytest.param("server", marks=pytest.mark.slow)])
def test_a_few_seconds_of_the_bench_give_all_figures_and_end_in_hold(where, tmp_path):
    plan = Plan(minutes=1, where=where, minute_s=8.0, alone_s=2.0, pairs=12)
    told = io.StringIO()
    minutes = bench(plan, tmp_path, Console(file=told, width=300))
    assert len(minutes) == 1
    minute = minutes[0]
    assert minute.last_state == "HOLD"
    assert minute.ended_in == "armed"
    assert minute.where == where
    assert minute.run_frac > 0.5
    assert minute.commands > 50
    assert len(minute.lateness_us) == len(minute.in_run) == minute.commands
    assert sum(minute.in_run) > 50
    assert minute.own_max_us >= minute.own_p50_us > 0.0
    assert minute.gap_max_ms >= 20.0
    assert minute.buffer_min_ms is not None
    assert minute.pairs > 0
    assert minute.underruns >= 0
    assert {"plc", "tap", "camera", "server"} <= set(minute.cpu_frac)
    assert minute.policies["plc"].startswith("SCHED_")
    assert ("link" in minute.policies) == (where == "process")
    assert "pairs/s" in line(minute)
    assert summary([minutes]).row_count == 14
    assert "vision alone" in told.getvalue()
    assert bench(plan, tmp_path, Console(file=told)) == minutes  # resumed: nothing runs again


def test_minutes_survive_being_saved_and_add_up():
    one = minute_from(json.loads(json.dumps(a_minute(1, [100, 200, 300], 2) | {"of a later version": 1})))
    other = minute_from(a_minute(2, [50, 9000], 1))
    total = total_of([one, other])
    assert total.underruns == 3
    assert total.minutes == pytest.approx(2.0)
    assert (total.lateness.n, total.lateness.p50_us, total.lateness.max_us) == (5, 200, 9000)
    assert (total.lateness_in_run.n, total.lateness_in_run.p50_us) == (3, 300)
    assert total.buffer_min_ms == pytest.approx(250.0)
    assert total.pairs_per_s == pytest.approx(15.0)
    assert asdict(one)["number"] == 1


def a_minute(number, late_us, underruns):
    return {
        "number": number,
        "where": "process",
        "seconds": 60.0,
        "underruns": underruns,
        "watchdog_trips": 0,
        "interruptions": [],
        "run_frac": 1.0,
        "commands": len(late_us),
        "lateness_us": late_us,
        "in_run": [0] + [1] * (len(late_us) - 1),
        "gap_max_ms": 21.0,
        "own_p50_us": 100.0,
        "own_p99_us": 200.0,
        "own_max_us": 300.0,
        "buffer_start_min_ms": None if number == 1 else 230.0,
        "buffer_min_ms": 250.0 if number == 1 else None,
        "lost_to_plc": 0,
        "lost_to_pc": 0,
        "pairs": 900,
        "process_ms": 40.0,
        "cpu_frac": {"plc": 0.2},
        "major_faults": {"plc": 0},
        "policies": {"plc": "SCHED_OTHER nice 0"},
        "warning": "",
        "load_average": 1.0,
        "last_state": "HOLD",
        "ended_in": "armed",
    }


def test_lateness_counts_from_the_grid_that_the_earliest_sends_show():
    late = [300, 0, 120, 25_000, 40, 10]  # us; the fourth misses its own deadline and the next one
    due = [0, 20, 40, 60, 100, 120]  # ms
    sent = [7 * MS + t * MS + us * 1000 for t, us in zip(due, late, strict=True)]
    assert lateness_us(sent, 20 * MS) == late
    assert lateness_us([], 20 * MS) == []


def test_one_stamp_that_is_too_early_does_not_make_all_others_late():
    sent = [7 * MS + 20 * i * MS + (-3 * MS if i == 400 else 50_000 * (i % 3)) for i in range(1000)]
    late = lateness_us(sent, 20 * MS)
    assert late[400] == 0
    assert max(late) == 100
    assert percentiles(late).p50_us == 50


def test_percentiles_are_of_all_values():
    found = percentiles(list(range(1, 1001)))
    assert (found.n, found.p50_us, found.p99_us, found.max_us) == (1000, 501, 991, 1000)
    assert percentiles([]).n == 0


@pytest.mark.parametrize("seconds", [1.0, 20.0, 60.0])
def test_back_and_forth_is_let_through_by_the_motion_gate(seconds):
    trajectory = back_and_forth(MACHINE, Q_START, seconds)
    knots = [
        Knot(t, pad_to_eight_axes(q), pad_to_eight_axes(qd), pad_to_eight_axes(qdd))
        for t, q, qd, qdd in knots_of(trajectory, 6)
    ]
    assert check_trajectory(knots, pad_to_eight_axes(tuple(Q_START)), limits_of(MACHINE.joints)) == ()
    assert trajectory.duration_s == pytest.approx(max(6.0, 6.0 * round(seconds / 6.0)))
    assert np.abs(trajectory.q - Q_START).max() > np.deg2rad(5.0)
    np.testing.assert_allclose(np.diff(trajectory.t_s), KNOT_S)
    np.testing.assert_array_equal(trajectory.q[-1], Q_START)


def test_the_replay_never_shows_a_picture_twice_in_a_row():
    order = to_and_fro(4)
    assert [next(order) for _ in range(9)] == [0, 1, 2, 3, 2, 1, 0, 1, 2]
