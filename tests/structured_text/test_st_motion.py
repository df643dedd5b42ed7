"""FB_HmMotion of the delivered PLC program gives the bits of the simulated PLC's reference, cycle by cycle."""

import inspect
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import test_st_motion_checks as checks
from st_motion_block import DeliveredMotion, program_of
from st_motion_cases import (
    BEGIN,
    CYCLE_S,
    END,
    FLAT,
    KNOTS,
    Q_START,
    SETTINGS,
    STEP,
    TAIL,
    load_all,
    pair_at,
    run_in,
    run_out,
    servo,
    traj,
)
from st_motion_drive import Trouble, drive
from st_motion_pair import MotionPair, Seen, settings_of
from st_sessions import quintic

from protocol.codes import CommandFlag, RejectCode
from protocol.messages import pad_to_eight_axes
from sim_plc.plc.reference import Motion

# --- motions, bit by bit (the pair compares every cycle) --------------------------------------------------------------


def test_a_trajectory_is_played_to_its_end() -> None:
    pair = pair_at()
    load_all(pair, KNOTS, BEGIN | END)
    assert run_out(pair) == 200
    assert pair.q_ref == pytest.approx(Q_START + STEP, abs=1e-12)
    assert pair.reference.knot_playing == 40


def test_the_speed_override_changes_on_the_way() -> None:
    pair = pair_at()
    load_all(pair, KNOTS, BEGIN | END)
    for override in (0.3, 0.9, 0.0, -0.0, 1.0):
        assert pair.deliver(traj(35, KNOTS[35:41], speed_override=override, cmd_flags=END)) is RejectCode.NONE
        for _ in range(25):
            pair.cycle()
    assert run_out(pair) > 50


@pytest.mark.parametrize("method", ["Stop", "QuickStop", "StopAlongPath"])
@pytest.mark.parametrize("after", [1, 40, 100, 190])
def test_every_stop_from_play(method: str, after: int) -> None:
    pair = pair_at()
    load_all(pair, KNOTS, BEGIN | END)
    for _ in range(after):
        pair.cycle()
    pair.stop(method)
    pair.stop(method)
    assert run_out(pair) <= 70
    assert pair.motion is Motion.HOLD


def test_knots_that_do_not_come_stop_it_before_the_last_one() -> None:
    pair = pair_at()
    load_all(pair, KNOTS[:24])
    assert run_out(pair) > 80
    assert pair.seen.events["starved"] == 1
    assert pair.reference.t_play_ns < KNOTS[23].t_ns


def test_a_path_that_is_cut_short_under_the_brake_goes_on_straight() -> None:
    pair = pair_at()
    load_all(pair, KNOTS[:22])
    while pair.reference.path_left_s > 0.015:
        pair.cycle(watch=False)
    pair.stop("StopAlongPath")
    run_out(pair)
    assert pair.seen.motions["JOINT_STOP"] > 10


@pytest.mark.parametrize("room", [0.08, 0.1, 0.13, 0.15, 0.17, 0.2])
def test_a_straight_stop_keeps_a_joint_in_its_range(room: float) -> None:
    end = SETTINGS.q_max[5]
    pair = pair_at(q=np.array([*Q_START[:5], end - 0.25]))
    speed = np.append(SETTINGS.qd_max[:1], np.zeros(5))  # the slew brakes longest, so the others would go on for long
    for i in range(100):
        last = end if i > 55 else end - 0.25
        assert pair.deliver(servo(np.array([pair.q_ref[0] + 0.05, *Q_START[1:5], last]), speed)) is RejectCode.NONE
        pair.cycle()
        if pair.q_ref[5] > end - room:
            break
    qd = np.abs(pair.reference.qd)
    leaves = bool(pair.q_ref[5] + 0.5 * qd[5] * np.max(qd / SETTINGS.qdd_stop) > end)
    assert leaves is (room < 0.19)
    pair.stop("Stop")
    run_out(pair)
    assert pair.q_ref[5] <= end


def test_a_servo_target_at_the_end_of_the_range_is_reached_and_not_passed() -> None:
    pair = pair_at(q=SETTINGS.q_max - 0.1)
    speed = 0.5 * SETTINGS.qd_max
    for _ in range(100):
        assert pair.deliver(servo(np.minimum(pair.q_ref + 0.05, SETTINGS.q_max), speed)) is RejectCode.NONE
        pair.cycle()
        assert (pair.q_ref <= SETTINGS.q_max).all()
    assert pair.q_ref == pytest.approx(SETTINGS.q_max, abs=1e-3)


def test_a_stop_with_too_little_path_left_goes_straight() -> None:
    pair = pair_at()
    load_all(pair, KNOTS[:22])
    while pair.reference.path_left_s > 0.05:
        pair.cycle(watch=False)
    pair.stop("Stop")
    assert pair.motion is Motion.JOINT_STOP
    run_out(pair)


def test_a_session_that_opens_under_a_ramp_lets_it_go_on_straight() -> None:
    pair = pair_at()
    load_all(pair, KNOTS, BEGIN | END)
    for _ in range(100):
        pair.cycle()
    pair.stop("Stop")
    pair.cycle()
    assert pair.motion is Motion.PATH_STOP
    pair.new_session()
    assert pair.motion is Motion.JOINT_STOP
    run_out(pair)
    pair.hold(Q_START, follow=True)
    assert pair.motion is Motion.FOLLOW


def test_a_servo_target_moves_on_then_stands_and_the_last_one_is_reached() -> None:
    pair = pair_at()
    speed = 0.4 * SETTINGS.qd_max
    for i in range(10):
        assert pair.deliver(servo(Q_START + speed * 0.02 * i, speed)) is RejectCode.NONE
        pair.cycle()
        pair.cycle()
    for _ in range(20):
        pair.cycle()
    assert pair.motion is Motion.SERVO
    assert pair.deliver(servo(Q_START + 0.02, cmd_flags=END, speed_override=0.5)) is RejectCode.NONE
    run_out(pair)
    assert pair.q_ref == pytest.approx(Q_START + 0.02, abs=1e-6)


def test_a_tail_is_replaced_and_a_new_session_starts_anew() -> None:
    pair = pair_at()
    load_all(pair, KNOTS, BEGIN | END)
    for _ in range(50):
        pair.cycle()
    other = tuple(quintic(KNOTS[20], Q_START + 0.8 * STEP, 1.2, 40))
    for first in range(0, len(other), 6):
        part = other[first : first + 6]
        flags = TAIL | (END if first + 6 >= len(other) else CommandFlag(0))
        assert pair.deliver(traj(21 + first, part, cmd_flags=flags)) is RejectCode.NONE
    run_out(pair)
    assert pair.q_ref == pytest.approx(Q_START + 0.8 * STEP, abs=1e-12)
    pair.new_session()
    again = tuple(replace(knot, q=pad_to_eight_axes(tuple(pair.q_ref.tolist()))) for knot in FLAT[:6])
    assert pair.deliver(traj(0, again, cmd_flags=BEGIN | END)) is RejectCode.NONE
    assert run_out(pair) == 25


@pytest.mark.parametrize("seed", [2, 7])
def test_seeded_motions_give_the_same_bits(seed: int) -> None:
    pair = pair_at()
    drive(pair, seed, 4, Trouble())
    assert pair.seen.cycles > 500


# --- the two functions ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("truncate", [False, True])
def test_rounding_is_to_the_even_one_whatever_the_conversion_does(truncate: bool) -> None:
    f_round: Callable[[float], int] = program_of(CYCLE_S, truncate=truncate).function("F_HmRound")
    rng = np.random.default_rng(4)
    halves = [x + 0.5 for x in range(-5, 6)] + [2.0**51 + 0.5, 2.0**51 + 1.5, 0.49999999999999994, -0.0, 2.0**60]
    for x in [*halves, *(rng.uniform(-1e12, 1e12, 200)), *(rng.uniform(-9, 9, 200))]:
        assert f_round(float(x)) == round(float(x))


def test_clamping_keeps_the_sign_of_zero_as_python_does() -> None:
    f_clamp: Callable[..., float] = program_of(CYCLE_S).function("F_HmClamp")
    values = (-1.0, -0.0, 0.0, 1.0)
    for x in values:
        for low in values:
            for high in values:
                expected = min(max(x, low), high)
                assert np.float64(f_clamp(x, low, high)).tobytes() == np.float64(expected).tobytes()


# --- long -------------------------------------------------------------------------------------------------------------

MINE = (
    "FB_HmMotion.",
    "FB_HmPath.",
    "FB_HmKnotRing.",
    "FB_HmKnotChecks.",
    "FB_HmServoAxis.",
    "F_HmRound ",
    "F_HmClamp ",
)
NEVER = {  # mirrored from Python, where nothing reaches them either; F_HmRound: only where conversions cut
    "FB_HmPath.PathLeft implementation line 5",
    "FB_HmPath.RateWithin implementation line 3",
    "F_HmRound implementation line 4",
    "F_HmRound implementation line 6",
}


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("cycle_s", [0.001, 0.004, 0.01])
def test_many_seeded_motions_give_the_same_bits(cycle_s: float) -> None:
    program, seen = program_of(cycle_s), Seen()
    for seed in range(100, 110 if cycle_s < 0.004 else 140):
        pair = MotionPair(DeliveredMotion(program), settings_of(cycle_s))
        drive(pair, seed, 6, Trouble(spoil=0.4))
        seen.rejects.update(pair.seen.rejects)
        seen.motions.update(pair.seen.motions)
    assert set(seen.motions) == {"HOLD", "PLAY", "PATH_STOP", "JOINT_STOP", "SERVO"}
    assert len(seen.rejects) >= 12


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_every_statement_of_the_motion_half_is_compared_somewhere() -> None:
    program = program_of(CYCLE_S, count=True)
    run_in(program)
    try:
        for case in checks.NEW_REFUSED:
            checks.test_a_new_trajectory_is_refused_with_the_field(*case)
        for case in checks.MORE_REFUSED:
            checks.test_knots_to_a_running_trajectory_are_refused_with_the_field(*case)
        for name, test in {**vars(checks), **globals()}.items():
            if name.startswith("test_") and not hasattr(test, "pytestmark") and inspect.isfunction(test):
                test()
        test_a_straight_stop_keeps_a_joint_in_its_range(0.1)
        for seed in range(100, 115):
            drive(pair_at(), seed, 6, Trouble(spoil=0.4))
    finally:
        run_in(None)
    assert {where for where in program.not_run() if where.startswith(MINE)} <= NEVER
