"""The steps that ask and move, with a link and an engineer that are stand-ins."""

import math

import numpy as np
import pytest
from commissioning_states import CHAIN, MACHINE, NAMES, N, Q, StandInLink, StandInOperator, health, sample, site

from protocol.codes import FaultBit
from protocol.limits import cfg_id, limits_of
from server.commissioning import stopping
from server.commissioning.check_list import compare_limits, compare_zeros, encoder_zeros
from server.commissioning.contracts import Verdict, result_of_figures
from server.commissioning.joint_ranges import end_figure, range_figures
from server.commissioning.joint_signs import expected_motion, jog_step, joint_signs, pressures_plausible, why_end_jog
from server.commissioning.link_dry_run import (
    closed_figures,
    dry_run_goal,
    guard_against_dry_run_movement,
    playback_figures,
)
from server.commissioning.moving import MachineReading, NoLeaveError, NotReadyError, PlayedMotion, at_rest, gentle_plan
from server.commissioning.stopping import EndedByItselfError, StopKind, by_itself, run_and_stop
from server.link.contracts import MotionEnded
from server.link.errors import LinkRefusedError
from server.motion.contracts import evaluate_trajectory

TABLE = limits_of(MACHINE.joints)
READING = MachineReading(Q, Q)
Q_DEG = np.rad2deg(Q).tolist()


# --- limits ---------------------------------------------------------------------------------------------------------


def test_equal_hashes_pass_others_fail_with_our_table():
    assert compare_limits(TABLE, cfg_id(TABLE)).verdict is Verdict.PASS
    other = compare_limits(TABLE, cfg_id(TABLE) ^ 1)
    assert other.verdict is Verdict.FAIL
    assert [row[0] for row in other.tables[0].rows] == NAMES
    assert repr(MACHINE.joints[1].qd_max_rad_s) in other.tables[0].rows[1][3]
    assert compare_limits(TABLE, 0).verdict is Verdict.INCONCLUSIVE


# --- zeros ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("off_deg", "verdict"), [(0.9, Verdict.PASS), (-0.9, Verdict.PASS), (1.1, Verdict.FAIL)])
def test_zeros_are_held_to_the_tolerance(off_deg, verdict):
    seen = [*Q_DEG[:2], Q_DEG[2] + off_deg, *Q_DEG[3:]]
    assert compare_zeros(NAMES, READING, seen, 1.0).verdict is verdict


def test_zeros_not_read_are_never_a_pass():
    assert compare_zeros(NAMES, READING, [None] * N, 1.0).verdict is Verdict.SKIPPED
    part = compare_zeros(NAMES, READING, [*Q_DEG[:5], None], 1.0)
    assert part.verdict is Verdict.INCONCLUSIVE
    assert "wrist3" in part.summary
    wrong = compare_zeros(NAMES, READING, [Q_DEG[0] + 5.0, *[None] * 5], 1.0)
    assert wrong.verdict is Verdict.FAIL


async def test_zeros_are_asked_for_every_joint_and_typing_errors_are_asked_again():
    class Stammering(StandInOperator):
        async def ask(self, key, question):
            self.asked.append(key)
            value = Q_DEG[NAMES.index(key.split(".")[1])]
            return "twelve" if self.asked.count(key) == 1 else f"{value:.2f}"

    operator = Stammering()
    result = await encoder_zeros(site(operator=operator))
    assert result.verdict is Verdict.PASS
    assert len(operator.asked) == 2 * N


# --- ranges ---------------------------------------------------------------------------------------------------------


def test_quiet_encoders_inside_their_ranges_pass():
    assert all(figure.ok for figure in range_figures([sample(10.0 * i) for i in range(50)], MACHINE.joints))


def test_outside_noisy_or_faulty_encoders_do_not():
    outside = (math.radians(171.0), *Q[1:])
    noisy = [sample(10.0 * i, q_rad=(*Q[:5], Q[5] + math.radians(0.1) * (i % 2))) for i in range(50)]
    faulty = [sample(0.0, fault_bits=int(FaultBit.SENSOR))]
    for samples in ([sample(0.0, q_rad=outside)], noisy, faulty):
        assert sum(not figure.ok for figure in range_figures(samples, MACHINE.joints)) == 1


@pytest.mark.parametrize(
    ("side", "q_deg", "ok"),
    [("lower", -30.0, True), ("lower", -22.0, False), ("upper", 85.0, True), ("upper", 70.0, False)],
)
def test_the_files_range_must_lie_inside_the_mechanical_ends(side, q_deg, ok):
    assert end_figure("lift", side, q_deg, -25.0 if side == "lower" else 80.0).ok is ok


# --- signs ----------------------------------------------------------------------------------------------------------


def right_answers(wrong=()):
    """What an engineer sees on a right machine, computed joint by joint where the stand-in starts."""
    answers = {}
    for index, name in enumerate(NAMES):
        step = jog_step(site(), Q, index)
        answers[f"joint_signs.{name}"] = expected_motion(CHAIN, Q, index, step).accepted_words[0]
    opposite = {"left": "right", "up": "down", "out": "in", "right": "left", "down": "up", "in": "out"}
    for name in wrong:
        answers[f"joint_signs.{name}"] = opposite[answers[f"joint_signs.{name}"]]
    return answers


async def test_joints_that_follow_and_are_seen_to_pass():
    link = StandInLink()
    result = await joint_signs(site(link, StandInOperator(right_answers())))
    assert result.verdict is Verdict.PASS, result.summary
    assert link.calls.count("run") == 2 * N
    assert link.q == pytest.approx(Q, abs=1e-9)


async def test_without_eyes_the_step_stays_open():
    result = await joint_signs(site())
    assert result.verdict is Verdict.INCONCLUSIVE
    assert "was not entered" in result.summary
    assert all(figure.ok for figure in result.figures)


async def test_a_tool_seen_to_go_the_wrong_way_fails():
    result = await joint_signs(site(operator=StandInOperator(right_answers(wrong=("lift",)))))
    assert result.verdict is Verdict.FAIL
    assert "lift: tool seen to go the wrong way" in result.summary
    assert [row[0] for row in result.tables[0].rows] == list(NAMES[:2])  # the others wait for the remedy


async def test_a_joint_that_runs_away_is_disarmed_at_once_and_ends_the_step():
    link = StandInLink(gain=-1.0)
    result = await joint_signs(site(link, StandInOperator(right_answers())))
    assert result.verdict is Verdict.FAIL
    assert "the wrong way" in result.summary
    assert link.calls.count("run") == 1
    assert "disarm" in link.calls
    assert abs(link.q[0] - Q[0]) < math.radians(1.5)


async def test_a_joint_that_does_not_follow_fails():
    result = await joint_signs(site(StandInLink(gain=0.0), StandInOperator(right_answers())))
    assert result.verdict is Verdict.FAIL
    assert "encoder followed" in result.summary


async def test_what_was_measured_is_kept_when_the_plc_refuses_midway():
    class Refusing(StandInLink):
        async def arm(self, timeout_s):
            if self.calls.count("run") == 2:
                raise LinkRefusedError("ENABLE")
            await super().arm(timeout_s)

        async def run(self, trajectory):
            ended = await super().run(trajectory)
            if self.calls.count("run") == 2:
                self.health = health()
            return ended

    result = await joint_signs(site(Refusing(), StandInOperator(right_answers())))
    assert result.verdict is Verdict.INCONCLUSIVE
    assert "lift: ENABLE" in result.summary
    assert len(result.tables[0].rows) == 1


async def test_what_was_measured_is_kept_when_leave_ends_midway():
    """Also a joint that went the wrong way: 'stop here' is what its remedy asks for."""

    class Leaving(StandInOperator):
        async def confirm(self, text):
            return not text.startswith("lift")

    result = await joint_signs(site(StandInLink(gain=0.0), Leaving(right_answers())))
    assert result.verdict is Verdict.FAIL
    assert "slew: encoder followed" in result.summary


def test_valves_that_open_while_nobody_commands_fail_the_dry_run():
    still = [sample(10.0 * k) for k in range(5)]
    assert all(figure.ok for figure in closed_figures(still, Q))
    moved = tuple(Q + np.deg2rad([0.0, 3.0, 0.0, 0.0, 0.0, 0.0]))
    driven = [*still, sample(60.0, q_rad=moved, plc_state="STOPPING"), sample(70.0, valve_frac=(0.0, 0.3, 0, 0, 0, 0))]
    assert [figure.ok for figure in closed_figures(driven, Q)] == [False, False]
    assert not any(figure.ok for figure in closed_figures([], Q))


async def test_a_motion_that_ends_before_it_is_stopped_is_told_as_that(monkeypatch):
    monkeypatch.setattr(stopping, "LINK_SILENCE_DURATION_S", 0.05)

    class Faulty(StandInLink):
        async def run(self, trajectory):
            return MotionEnded(1, False, "fault LAG", 0)

    where = site(Faulty())
    plan = gentle_plan(where, Q, Q + 0.02)
    with pytest.raises(EndedByItselfError, match="fault LAG") as ended:
        await run_and_stop(where, plan.trajectory, StopKind.STOP, "tool at 100 %")
    assert not by_itself("tool at 100 %", ended.value).ok


@pytest.mark.parametrize(("leave", "confirms"), [(False, True), (True, False)])
async def test_nothing_moves_without_leave_or_confirmation(leave, confirms):
    link = StandInLink()
    with pytest.raises(NoLeaveError):
        await joint_signs(site(link, StandInOperator(leave=leave, confirms=confirms)))
    assert link.calls == []


def test_the_guard_lets_a_right_jog_pass_and_objects_to_others():
    step = math.radians(2.0)

    def moved(index, deg):
        q = Q.copy()
        q[index] += math.radians(deg)
        return why_end_jog(sample(0.0, q_rad=tuple(q)), Q, 0, step)

    assert moved(0, 2.3) == ""
    assert moved(0, -0.9) == ""
    assert "the wrong way" in moved(0, -1.1)
    assert "were commanded" in moved(0, 4.1)
    assert "another joint" in moved(3, 1.1)
    assert moved(3, 0.9) == ""


def test_a_jog_goes_to_the_side_with_room():
    q = Q.copy()
    q[1] = MACHINE.joints[1].q_max_rad - math.radians(1.0)
    assert jog_step(site(), q, 1) < 0.0
    assert jog_step(site(), Q, 1) > 0.0


def test_a_jog_without_room_is_refused():
    q = Q.copy()
    q[1] = math.radians(120.0)
    with pytest.raises(NotReadyError, match="no room"):
        jog_step(site(), q, 1)


@pytest.mark.parametrize(("p", "ok"), [(0.0, True), (4e7, True), (6e7, False), (-2e5, False)])
def test_chamber_pressures_must_be_plausible(p, ok):
    assert pressures_plausible([sample(0.0, pressure_b_pa=(p, *(5e6,) * (N - 1)))], 0) is ok


# --- dry run --------------------------------------------------------------------------------------------------------


def dry_play(shift_rad=0.0, q_moves_rad=0.0, valve=0.0, underruns=0, reached=True):
    plan = gentle_plan(site(), Q, dry_run_goal(MACHINE, Q))
    times = np.arange(0.0, plan.trajectory.duration_s, 0.01)
    refs = evaluate_trajectory(plan.trajectory, times).q + shift_rad
    states = [
        sample(
            1e3 * t,
            plc_state="RUN",
            t_play_ns=round(t * 1e9),
            q_ref_rad=tuple(ref),
            q_rad=tuple(Q + q_moves_rad * (i > 100)),
            valve_frac=(valve,) * N,
            underruns=underruns * (i > 50),
        )
        for i, (t, ref) in enumerate(zip(times, refs, strict=True))
    ]
    states.append(sample(4e3, q_ref_rad=tuple(plan.trajectory.q[-1])))
    played = PlayedMotion(MotionEnded(1, reached, "reached" if reached else "stopped", 0), states, "")
    return [figure for figure in playback_figures(played, plan.trajectory, MACHINE) if not figure.ok]


def test_playback_as_sent_with_closed_valves_is_right():
    assert dry_play() == []


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        ({"shift_rad": 1e-6}, "off its path"),
        ({"q_moves_rad": 0.01}, "encoders moved"),
        ({"valve": 0.01}, "valve command"),
        ({"underruns": 1}, "underruns"),
        ({"reached": False}, "ended early"),
    ],
)
def test_every_fault_of_the_playback_is_told(fault, told):
    wrong = dry_play(**fault)
    assert len(wrong) == 1
    assert told in wrong[0].name


def test_a_playback_without_motion_is_told():
    played = PlayedMotion(MotionEnded(1, False, "the link was closed", 0), [sample(0.0)], "")
    plan = gentle_plan(site(), Q, dry_run_goal(MACHINE, Q))
    assert "the link was closed" in playback_figures(played, plan.trajectory, MACHINE)[0].name


def test_the_dry_guard_objects_to_motion():
    guard = guard_against_dry_run_movement(Q)
    assert guard(sample(0.0)) == ""
    assert "in a dry run" in guard(sample(0.0, q_rad=(Q[0] + 0.01, *Q[1:])))


def test_the_dry_goal_stays_inside_the_ranges():
    for q in (np.array([j.q_min_rad for j in MACHINE.joints]), np.array([j.q_max_rad for j in MACHINE.joints]), Q):
        goal = dry_run_goal(MACHINE, q)
        assert all(j.q_min_rad <= g <= j.q_max_rad for j, g in zip(MACHINE.joints, goal, strict=True))


# --- rest -----------------------------------------------------------------------------------------------------------


def test_rest_needs_still_encoders_a_still_reference_and_enough_of_both():
    still = [sample(10.0 * i) for i in range(50)]
    assert at_rest(still)
    assert not at_rest(still[:20])
    assert not at_rest([])
    creeping = [sample(10.0 * i, q_rad=(Q[0] + 1e-5 * i, *Q[1:])) for i in range(50)]
    assert not at_rest(creeping)
    assert not at_rest([*still[:-1], sample(490.0, qd_ref_rad_s=(0.01, *(0.0,) * (N - 1)))])


def test_a_verdict_is_fail_before_open_before_pass():
    figures = range_figures([sample(10.0 * i) for i in range(50)], MACHINE.joints)
    assert result_of_figures("x", figures, "fine", "do").verdict is Verdict.PASS
    assert result_of_figures("x", figures, "fine", "do", ["not seen"]).verdict is Verdict.INCONCLUSIVE
    wrong = range_figures([sample(0.0, fault_bits=int(FaultBit.SENSOR))], MACHINE.joints)
    assert result_of_figures("x", wrong, "fine", "do", ["not seen"]).verdict is Verdict.FAIL
