"""Steering: what the next pair's report says of silence, unfit pictures, missing encoders, corrections and ends."""

import asyncio
from types import SimpleNamespace

import numpy as np
import pytest

from recording.clock import mono_ns
from server.errors import JobFailedError
from server.jobs.requests import Correct, NextPair
from server.jobs.steering import FIRST_PAIR_TIMEOUT_S, STEER_TIMEOUT_GRACE_S, Steering
from server.link.contracts import MotionEnded
from server.link.errors import LinkRefusedError
from server.motion.contracts import JointTrajectory

STILL = np.zeros((3, 6))
PATH = JointTrajectory(np.array([0.0, 0.05, 0.1]), STILL, STILL, STILL)
OFFSET_NS = 5_000_000_000  # t_pc - t_plc


def sample(t_mono_ns):
    t_plc_ns = t_mono_ns - OFFSET_NS
    return SimpleNamespace(t_plc_ns=t_plc_ns, t_mono_ns=t_mono_ns, q_rad=(t_plc_ns * 1e-9, *[0.0] * 5))


class Link:
    """Joint 0 turns by 1 rad/s of PLC time; motions end and corrections are answered when the test says so."""

    plc_to_pc_offset_ns = OFFSET_NS

    def __init__(self):
        self.motion = self.tail = None
        self.silent_since_ns = None  # from when on samples are still on their way
        self.until = []  # what the motion was let go on to [monotonic ns]

    async def steer_until(self, t_mono_ns):
        self.until.append(t_mono_ns)

    def samples_since(self, t_mono_ns):
        now = self.newest_ns()
        stamps = range(max(t_mono_ns, now - int(1e9)), now, 10_000_000)
        return [
            SimpleNamespace(t_plc_ns=t - OFFSET_NS, t_mono_ns=t, q_rad=((t - OFFSET_NS) * 1e-9, *[0.0] * 5))
            for t in stamps
        ]

    def newest_ns(self):
        return self.silent_since_ns or mono_ns()

    @property
    def latest(self):
        t_ns = self.newest_ns()
        return SimpleNamespace(plc_state="RUN", t_play_ns=700_000_000, t_mono_ns=mono_ns(), t_plc_ns=t_ns - OFFSET_NS)

    async def run(self, trajectory):
        self.motion = asyncio.get_running_loop().create_future()
        return await self.motion

    async def correct(self, trajectory, first):
        self.tail = asyncio.get_running_loop().create_future()
        await self.tail


class Vision:
    def on_report(self, callback):
        self.report = callback


def report(age_s=0.06, warnings=()):
    exposed_ns = mono_ns() - int(age_s * 1e9)
    observation = SimpleNamespace(tool="the tool", ooi="the object")
    return SimpleNamespace(t_exposure_mapped_ns=exposed_ns, warnings=warnings, observation=observation)


@pytest.fixture
def cell():
    return SimpleNamespace(link=Link(), vision=Vision())


def asked(after=0, silence_max_s=5.0, time_offset_s=0.0):
    return NextPair(after, silence_max_s, time_offset_s)


async def begun(cell):
    steering = Steering(cell)
    await steering.start(PATH)
    return steering


async def test_a_pair_comes_with_the_joints_at_its_own_exposure(cell):
    steering = await begun(cell)
    one = report(age_s=0.2)
    cell.vision.report(one)
    seen = await steering.next_pair(asked(time_offset_s=-0.05))
    assert (seen.number, seen.fault, seen.tool, seen.motion_ended) == (1, "", "the tool", False)
    assert seen.q_rad[0] == pytest.approx((one.t_exposure_mapped_ns - OFFSET_NS) * 1e-9 - 0.05, abs=1e-6)
    assert seen.t_play_s == pytest.approx(0.7, abs=0.05)
    await steering.forget_motion()


async def test_the_newest_pair_is_given_and_none_twice(cell):
    steering = await begun(cell)
    for _ in range(3):
        cell.vision.report(report())
    assert (await steering.next_pair(asked())).number == 3
    waiting = asyncio.create_task(steering.next_pair(asked(after=3)))
    await asyncio.sleep(0.0)
    assert not waiting.done()
    cell.vision.report(report())
    assert (await waiting).number == 4
    await steering.forget_motion()


async def test_silence_is_a_fault_that_counts_from_the_last_pair(cell):
    steering = await begun(cell)
    cell.vision.report(report())
    seen = await steering.next_pair(asked(after=1, silence_max_s=0.03))
    assert (seen.number, seen.fault, seen.q_rad) == (
        1,
        "no pair for 30 ms; check the camera, its cable and its rate",
        None,
    )
    await steering.forget_motion()


@pytest.mark.parametrize(
    ("one", "word"),
    [
        (lambda: report(warnings=("left eye is dark",)), "left eye is dark"),
        (lambda: report(age_s=4.0), "no encoders"),
        (lambda: report(age_s=-0.5), "no encoders"),
    ],
)
async def test_an_unfit_pair_says_why(cell, one, word):
    steering = await begun(cell)
    cell.vision.report(one())
    assert word in (await steering.next_pair(asked())).fault
    await steering.forget_motion()


async def test_a_pair_waits_a_little_for_encoders_that_are_on_their_way(cell):
    steering = await begun(cell)
    cell.link.silent_since_ns = mono_ns() - 100_000_000
    cell.vision.report(report(age_s=0.0))
    asking = asyncio.create_task(steering.next_pair(asked()))
    await asyncio.sleep(0.02)
    assert not asking.done()
    cell.link.silent_since_ns = None
    assert (await asking).fault == ""
    cell.link.silent_since_ns = mono_ns() - 100_000_000
    cell.vision.report(report(age_s=0.0))
    assert "no encoders" in (await steering.next_pair(asked(after=1))).fault  # but not for ever
    await steering.forget_motion()


async def next_tail(cell, steering, number):
    await asyncio.sleep(0.0)
    cell.vision.report(report())
    seen = await steering.next_pair(asked(after=number))
    return seen.tail_status, seen.tail_text


async def test_a_correction_never_keeps_a_pair_waiting_and_its_answer_is_told_once(cell):
    steering = await begun(cell)
    steering.correct(Correct(PATH, 2))
    assert await next_tail(cell, steering, 0) == ("pending", "")
    cell.link.tail.set_result(None)
    await asyncio.sleep(0.0)
    assert await next_tail(cell, steering, 1) == ("taken", "")
    assert await next_tail(cell, steering, 2) == ("none", "")
    steering.correct(Correct(PATH, 2))
    await asyncio.sleep(0.0)
    cell.link.tail.set_exception(LinkRefusedError("begins too near"))
    await asyncio.sleep(0.0)
    assert await next_tail(cell, steering, 3) == ("refused", "begins too near")
    await steering.forget_motion()


async def test_the_end_is_told_and_an_early_one_fails(cell):
    steering = await begun(cell)
    cell.link.motion.set_result(MotionEnded(1, True, "reached", 0))
    await asyncio.sleep(0.0)
    cell.vision.report(report())
    assert (await steering.next_pair(asked())).motion_ended
    await steering.wait_for_end()
    await steering.start(PATH)
    cell.link.motion.set_result(MotionEnded(2, False, "underrun", 0))
    with pytest.raises(JobFailedError, match="ended early: underrun"):
        await steering.wait_for_end()


async def test_a_stopped_motion_leaves_no_task_behind(cell):
    steering = await begun(cell)
    steering.correct(Correct(PATH, 2))
    await asyncio.sleep(0.0)
    await steering.forget_motion()
    await asyncio.sleep(0.0)
    assert {task.get_name() for task in asyncio.all_tasks()}.isdisjoint({"steered-motion", "new-tail"})
    cell.vision.report(report())
    assert (await steering.next_pair(asked())).motion_ended


async def test_a_pair_that_waited_behind_a_stall_is_too_old_to_act_upon(cell):
    """Silence counts from when a report was taken in: a stalled process would take old pairs for new ones."""
    steering = await begun(cell)
    cell.vision.report(report(age_s=0.06))
    assert (await steering.next_pair(asked(silence_max_s=0.15))).fault == ""
    cell.vision.report(report(age_s=0.18))  # slow, but within silence and the fastest pair's latency
    assert (await steering.next_pair(asked(after=1, silence_max_s=0.15))).fault == ""
    cell.vision.report(report(age_s=0.4))
    seen = await steering.next_pair(asked(after=2, silence_max_s=0.15))
    assert seen.number == 3
    assert "the newest pair is 40" in seen.fault
    assert "limit 21" in seen.fault
    await steering.forget_motion()


async def test_only_a_pair_without_a_fault_lets_the_motion_go_on(cell):
    steering = await begun(cell)
    (first_ns,) = cell.link.until  # before the trajectory is asked for
    assert 0 < first_ns - mono_ns() <= FIRST_PAIR_TIMEOUT_S * 1e9
    cell.vision.report(report())
    before_ns = mono_ns()
    await steering.next_pair(asked(silence_max_s=0.15))
    after_ns = mono_ns()
    assert before_ns <= cell.link.until[1] - int((0.15 + STEER_TIMEOUT_GRACE_S) * 1e9) <= after_ns
    cell.vision.report(report(warnings=("left eye is dark",)))
    await steering.next_pair(asked(after=1))
    await steering.next_pair(asked(after=2, silence_max_s=0.01))  # silence
    assert len(cell.link.until) == 2
    await steering.forget_motion()
    assert cell.link.until[2:] == [None]


async def test_a_motion_at_its_end_needs_no_more_pairs(cell):
    steering = await begun(cell)
    cell.link.motion.set_result(MotionEnded(1, True, "reached", 0))
    await asyncio.sleep(0.0)
    cell.vision.report(report())
    await steering.next_pair(asked())
    await steering.wait_for_end()
    assert cell.link.until[1:] == [None]
    cell.vision.report(report())
    await steering.next_pair(asked(after=1))  # at rest: nothing to let go on
    assert cell.link.until[1:] == [None]
