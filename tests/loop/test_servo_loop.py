"""Closed-loop control against the real PLC program and plant, in virtual time: it arrives, and it stops when blind."""

import numpy as np
import pytest
from servo_virtual import MS, VirtualCell, drive

from protocol.codes import PlcState
from server.calibration.calibration_life import CalibrationValidity, ValidityStatus
from server.errors import JobFailedError
from server.jobs.plans import servoing
from server.jobs.plans.servoing import servo
from server.jobs.requests import Correct, NextPair, StopMove

RAMP_WITHIN_NS = 200 * MS


def steered(cell, ctx):
    return drive(servo(ctx, lambda: cell.t_ns), cell)


def test_it_arrives_with_new_tails_and_never_faster_than_it_may():
    cell = VirtualCell(preset="ideal", seed=1, rate_hz=20.0, start_error_mm=(2.0, -2.0, 6.0))
    ctx = cell.context(speed_max_mm_s=40.0)
    ctx.knowledge.stall_rad = np.zeros(6)
    result = steered(cell, ctx)
    assert result.reached, result.reason
    assert result.corrections >= 1
    assert any(isinstance(request, Correct) for _, request in cell.told)
    assert np.abs(cell.error_mm()).max() < 3.0
    trace = cell.virtual.trace()
    points = trace.Ts_base_tcp[:, :3, 3]
    speeds = np.linalg.norm(np.diff(points, axis=0), axis=1) / np.diff(trace.t_s)
    assert speeds.max() < 0.040


def first_lost(cell):
    return next(frame for frame in cell.frames if frame.hidden)


@pytest.mark.parametrize(("rate_hz", "latency_s", "in_motion"), [(60.0, 0.040, 1), (60.0, 0.040, 2), (15.0, 0.080, 2)])
def test_a_marker_lost_on_the_way_is_answered_by_a_ramp_within_200_ms(rate_hz, latency_s, in_motion):
    cell = VirtualCell(seed=2, rate_hz=rate_hz, latency_s=latency_s, hidden_from_s=1.5, in_motion=in_motion)
    with pytest.raises(JobFailedError, match=r"first invalid look: object of interest: no marker") as failed:
        steered(cell, cell.context())
    assert failed.value.code == "servo_look_lost"
    assert (
        cell.t_stop_ns - first_lost(cell).t_exposure_ns <= RAMP_WITHIN_NS
    )  # PLC time, from the exposure that lacks it
    assert cell.virtual.machine.plc.state is PlcState.HOLD
    if in_motion == 2 and rate_hz == 60.0:
        assert any(isinstance(request, Correct) for _, request in cell.told)  # it was lost while being corrected


def test_a_camera_that_falls_silent_is_answered_by_a_ramp_within_200_ms_of_its_last_pair():
    cell = VirtualCell(seed=2, silent_from_s=1.5)
    with pytest.raises(JobFailedError, match="no pair for 100 ms"):
        steered(cell, cell.context())
    assert cell.t_stop_ns - cell.frames[-1].t_exposure_ns <= RAMP_WITHIN_NS


def test_after_the_stop_nothing_is_asked_for_any_more():
    cell = VirtualCell(seed=2, hidden_from_s=1.5)
    with pytest.raises(JobFailedError):
        steered(cell, cell.context())
    assert isinstance(cell.told[-1][1], StopMove)
    q_ref = cell.virtual.q_ref
    cell.step(500)
    np.testing.assert_array_equal(cell.virtual.q_ref, q_ref)


@pytest.mark.parametrize(
    ("error_mm", "word"), [((10.0, 5.0, 160.0), "at most 150 mm"), ((0.0, -170.0, 0.0), "at most 150 mm")]
)
def test_too_far_is_refused_and_nothing_moves(error_mm, word):
    cell = VirtualCell(preset="ideal", start_error_mm=error_mm)
    with pytest.raises(JobFailedError, match=word):
        steered(cell, cell.context())
    assert all(state is not PlcState.RUN for _, state in cell.states)


def test_unsharp_pairs_are_refused_before_anything_moves():
    cell = VirtualCell(preset="ideal")
    with pytest.raises(JobFailedError, match=r"not reliable enough.*limit 0\.1 mm"):
        steered(cell, cell.context(sigma_max_mm=0.1))
    assert all(state is not PlcState.RUN for _, state in cell.states)


def test_a_gap_at_rest_only_makes_it_wait_for_a_new_row():
    late = VirtualCell(
        preset="ideal", gap_at_rest=(94, 112), hidden_from_s=0.3
    )  # 0.3 s without a pair, then all is well
    with pytest.raises(JobFailedError, match="first invalid look"):  # it did begin
        steered(late, late.context())
    waited = [request.silence_max_s for _, request in late.told if isinstance(request, NextPair)]
    assert waited.count(1.0) >= 2
    assert any(state is PlcState.RUN for _, state in late.states)


def test_a_camera_that_slipped_during_a_pass_ends_the_job_before_the_next_one(monkeypatch):
    cell = VirtualCell(preset="ideal", seed=1, rate_hz=20.0)
    ctx = cell.context(passes_max=3)
    passes, asked = [], servoing.calibration_validity

    def validity(ctx, reading):
        slipped = CalibrationValidity(ValidityStatus.SLIPPED, "tool marker moved by 64.2 mm")
        return slipped if passes else asked(ctx, reading)

    def one_pass(*args):
        passes.append(1)
        return (yield from done(*args))

    done = servoing._one_pass
    monkeypatch.setattr(servoing, "calibration_validity", validity)
    monkeypatch.setattr(servoing, "_one_pass", one_pass)
    monkeypatch.setattr(servoing, "is_look_inside_tolerance", lambda _ctx, _taken: False)
    with pytest.raises(JobFailedError, match=r"64\.2 mm"):
        steered(cell, ctx)
    assert len(passes) == 1
