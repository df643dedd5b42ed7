"""SIGKILL of the link process and of the PLC in the middle of a job of the real server; and how a case is judged."""

import json
import os
from dataclasses import asdict, replace

import pytest

from benchmarks.kills.case import KillCase, Observed, failed_case, judged
from benchmarks.kills.drill import run_case
from benchmarks.kills.figures import KillFigures
from benchmarks.kills.plc_process import free_udp_port
from benchmarks.kills.repeated import UnknownVictimError, line, load_case, summary, victims_of
from benchmarks.kills.victims import children_of, holder_of_udp_port
from machine.description import parse_machine_toml
from protocol.codes import PlcState
from protocol.messages import State, pad_to_eight_axes
from server.link.udp_end import UdpEnd
from server.settings import read_machine_text

MACHINE = parse_machine_toml(read_machine_text("hiab033"))
MS = 1_000_000
Q = (0.2, 0.7, -1.4, 0.1, -0.7, 0.05)
INTERRUPTED = {"state": "failed", "reason": "motion ended early: the link process died"}


@pytest.mark.system
@pytest.mark.slow
@pytest.mark.timeout(240)
@pytest.mark.parametrize("victim", ["link", "plc"])
def test_a_kill_in_the_middle_of_a_job(victim, tmp_path):
    case = run_case(victim, 1, 1, tmp_path)
    print("\n" + line(case))
    assert [text for text in case.violations if "TCP travels" not in text] == []
    assert case.job_state == "failed"
    assert case.again == "done"
    if case.figures is not None:
        assert case.figures.reference_travel_mm <= 50.0  # 0.15 m/s for 250 ms, and the ramp
        assert case.figures.tcp_travel_mm <= 100.0  # and what the boom was behind its reference


# --- judging, on states made by hand -------------------------------------------------------------------------------


def a_state(i, plc_state, speed=0.0, rx_age_ms=10.0, q=Q):
    return State(
        session=1,
        seq=i + 1,
        t_send_ns=10 * i * MS,
        plc_state=plc_state,
        rx_age_us=round(rx_age_ms * 1000),
        q=pad_to_eight_axes(q),
        q_ref=pad_to_eight_axes(q),
        qd_ref=pad_to_eight_axes((speed, 0.0, 0.0, 0.0, 0.0, 0.0)),
    )


def a_move(silence_ms=250.0, step=1.0):
    """100 states at an even speed; then silence, and the slew ramps down at `step` times its 40 deg/s^2."""
    qdd = 40.0 * 3.141592653589793 / 180.0
    states = [a_state(i, PlcState.RUN, 0.1) for i in range(100)]
    silent = [a_state(100 + k, PlcState.RUN, 0.1, 10.0 * (k + 2)) for k in range(round(silence_ms / 10.0) - 2)]
    speeds = [max(0.0, 0.1 - step * qdd * 0.01 * (k + 1)) for k in range(20)]
    first = 100 + len(silent)
    ramp = [a_state(first + k, PlcState.STOPPING, speed) for k, speed in enumerate(speeds) if speed > 0.0]
    rest = [a_state(first + len(ramp) + k, PlcState.HOLD) for k in range(50)]
    return (*states, *silent, *ramp, *rest)


def an_end():
    names = [PlcState.LINKED, PlcState.HOLD, PlcState.RUN, PlcState.HOLD]
    return tuple(a_state(i, name) for i, name in enumerate(names))


def observed(**changes):
    seen = Observed(
        machine=MACHINE,
        planned_s=3.5,
        move=a_move(),
        quiet=(a_state(0, PlcState.DISARMED), a_state(1, PlcState.LINKED)),
        after=an_end(),
        job=INTERRUPTED,
        job_ended_s=0.1,
        again={"state": "done", "reason": ""},
    )
    return replace(seen, **changes)


def test_a_case_within_its_bounds_has_no_violations():
    case = judged("link", 1, 1, 0.5, observed(), 10.0)
    assert case.violations == []
    assert case.figures.ramp_start_ms == pytest.approx(250.0, abs=12.0)
    assert case.figures.ramp_ms <= case.figures.ramp_bound_ms + 12.0
    assert case.states_after == ["DISARMED", "LINKED"]
    assert case.armed_anew
    assert case.step == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"move": a_move(silence_ms=300.0)}, "ramp starts"),
        ({"move": a_move(step=0.5)}, "ramp takes"),
        ({"move": a_move(step=1.3)}, "qd_ref steps"),
        ({"quiet": (a_state(0, PlcState.LINKED), a_state(1, PlcState.HOLD))}, "PLC in HOLD before anybody armed"),
        ({"quiet": (a_state(0, PlcState.LINKED), a_state(1, PlcState.LINKED, q=(0.3, *Q[1:])))}, "encoders moved"),
        ({"quiet": ()}, "no state of the PLC after the restart"),
        ({"after": an_end()[2:]}, "without arming"),
        ({"again": {"state": "failed", "reason": "no"}}, "the next job ended"),
        ({"job": {}}, "does not know the job"),
        ({"job": {"state": "running", "reason": ""}}, "the job is reported as 'running'"),
        ({"job": {"state": "failed", "reason": "something"}}, "does not name the link process"),
    ],
)
def test_what_does_not_hold_is_told(changes, text):
    violations = judged("link", 1, 1, 0.5, observed(**changes), 10.0).violations
    assert any(text in violation for violation in violations), violations


def test_a_tool_that_goes_too_far_is_told():
    far = tuple(replace(s, q=pad_to_eight_axes((0.3, *Q[1:]))) if s.plc_state is PlcState.HOLD else s for s in a_move())
    violations = judged("link", 1, 1, 0.5, observed(move=far), 10.0).violations
    assert any("TCP travels" in violation for violation in violations)


def test_of_a_killed_plc_only_the_report_and_the_restart_are_judged():
    running = tuple(a_state(i, PlcState.RUN, 0.1) for i in range(50))
    job = {"state": "failed", "reason": "retract: motion ended early: no state from the PLC for 1 s"}
    case = judged("plc", 1, 1, 0.5, observed(move=running, job=job), 10.0)
    assert case.figures is None
    assert case.violations == []
    silent = judged("plc", 1, 1, 0.5, observed(move=running, job=INTERRUPTED), 10.0)
    assert any("PLC's silence" in violation for violation in silent.violations)


def test_cases_are_saved_and_summed_up():
    case = judged("link", 3, 1, 0.5, observed(), 10.0)
    again = load_case(json.dumps(asdict(case)))
    assert isinstance(again, KillCase)
    assert isinstance(again.figures, KillFigures)
    assert again == case
    failed = failed_case("plc", 1, 1, TimeoutError("no link"), 5.0)
    assert "no link" in line(failed)
    assert summary([case, failed]).row_count == 2


def test_victims_are_named_or_refused():
    assert victims_of("plc, server") == ["server", "plc"]
    with pytest.raises(UnknownVictimError, match="camera"):
        victims_of("server,camera")
    with pytest.raises(UnknownVictimError):
        victims_of("")


def test_the_holder_of_a_port_is_found_among_the_children_only():
    port = free_udp_port()
    end = UdpEnd(("127.0.0.1", port))
    try:
        assert holder_of_udp_port(port, os.getpid()) is None
        assert os.getpid() in children_of(os.getppid())
        assert holder_of_udp_port(port, os.getppid()) == os.getpid()
    finally:
        end.close()
