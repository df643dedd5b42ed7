"""The paper's own way to drive: no stall map, no trims, the error integrated at rest; and looks on the way."""

import asyncio
from types import SimpleNamespace

import numpy as np
import pytest
from reproduce_worlds import NO_NOISE, machine, world

from benchmarks.reproduce.fast_camera import FastCamera
from benchmarks.reproduce.fast_cell import context_of, fast_cell, run_plan
from benchmarks.reproduce.fast_machine import QuasiStaticMachine
from machine.chain import chain_of
from machine.poses import pose
from server.errors import JobFailedError
from server.jobs.performer import Performer
from server.jobs.plans.driving import INTEGRATION_STEPS_MAX, correct_encoder_shortfall, drive_and_correct
from server.jobs.plans.planning import plan_to
from server.jobs.requests import MachineReading, Move, SeenPairs, Settle, StartWatching, StopWatching, sighted_of
from server.vision.object_pose import not_seen
from sim_plc.world import rng_for

PAIRS_HZ = 10.0


def reading(q: np.ndarray, q_ref: np.ndarray) -> MachineReading:
    return MachineReading(q, q_ref, 0, 0)


def paper_plan(shift_m: float):
    """A context of the paper's method at a drawn machine, where it stands, and a plan for a move along base z."""
    one = world("paper", 2)
    ctx = context_of(one, "paper")
    cell = fast_cell(one, QuasiStaticMachine(one), NO_NOISE)
    now = cell.perform(Settle())
    T_goal = ctx.tcp(now.q_rad)
    T_goal[2, 3] += shift_m
    return ctx, cell, now, plan_to(ctx, now, T_goal)


def test_the_papers_reference_ends_at_the_goal_itself():
    ctx, _, now, plan = paper_plan(-0.05)
    np.testing.assert_allclose(plan.trajectory.q[-1], plan.q_end, atol=1e-9)
    np.testing.assert_allclose(plan.trajectory.q[0], now.q_ref_rad, atol=1e-12)
    ours = context_of(world("paper", 2), "ours")
    shaped = plan_to(ours, now, ctx.tcp(plan.q_end))
    assert np.abs(shaped.trajectory.q[-1] - shaped.q_end).max() > 1e-3  # ours goes on by the stall


def integrated(ctx, plan, q: np.ndarray, follows: bool) -> tuple[int, list[np.ndarray]]:
    """Steps told and references moved to, for a machine at q that follows at once, or never does."""
    steps, q_ref, moves = correct_encoder_shortfall(ctx, plan, "move"), plan.q_end, []
    try:
        request = next(steps)
        while True:
            if isinstance(request, Move):
                q_ref = request.trajectory.q[-1]
                moves.append(q_ref)
                q = plan.q_end if follows else q
            request = steps.send(reading(q, q_ref) if isinstance(request, Settle) else None)
    except StopIteration as end:
        return end.value, moves


def test_integration_adds_what_the_encoders_lack_and_stops_when_they_lack_nothing():
    ctx, _, _, plan = paper_plan(-0.05)
    lacking = np.array([0.0, 2e-3, -1e-3, 0.0, 0.0, 0.0])
    count, moves = integrated(ctx, plan, plan.q_end - lacking, follows=True)
    assert count == 1
    np.testing.assert_allclose(moves, [plan.q_end + lacking], atol=1e-9)


def test_integration_gives_up_on_a_machine_that_does_not_follow():
    ctx, _, _, plan = paper_plan(-0.05)
    lacking = np.array([0.0, 1e-3, 0.0, 0.0, 0.0, 0.0])
    count, moves = integrated(ctx, plan, plan.q_end - lacking, follows=False)
    assert count == len(moves) == INTEGRATION_STEPS_MAX
    assert moves[-1][1] - plan.q_end[1] == pytest.approx(INTEGRATION_STEPS_MAX * 1e-3)


def test_integration_keeps_off_the_wall():
    ctx, _, _, plan = paper_plan(-0.05)
    lacking = np.array([0.0, -2e-3, 0.0, 0.0, 0.0, 0.0])  # the lift still has to come down
    ctx.knowledge.T_base_ooi = pose(np.eye(3), ctx.tcp(plan.q_end)[:3, 3] - [0.0, 0.0, 0.04])
    with pytest.raises(JobFailedError, match=r"comes to \d+ mm from the wall, limit 50 mm; choose") as failure:
        integrated(ctx, plan, plan.q_end - lacking, follows=True)
    assert failure.value.code == "trim_refused"


def short_of_it(steps, rest: MachineReading) -> None:
    """Play a plan on a machine that always comes to the same rest."""
    reply = None
    for _ in range(100):
        request = steps.send(reply)
        reply = rest if isinstance(request, Settle) else None


def test_a_trim_is_told_of_the_wall():
    one = world("paper", 2)
    ctx, cell = context_of(one, "ours"), fast_cell(one, QuasiStaticMachine(one), NO_NOISE)
    now = cell.perform(Settle())
    plan = plan_to(ctx, now, ctx.tcp(now.q_rad - [0.0, 0.01, 0.0, 0.0, 0.0, 0.0]))
    ctx.knowledge.T_base_ooi = pose(np.eye(3), ctx.tcp(plan.q_end)[:3, 3] - [0.0, 0.0, 0.051])
    with pytest.raises(
        JobFailedError, match=r"move: correction: tool comes to \d+ mm from the wall, limit 50 mm"
    ) as failure:
        short_of_it(drive_and_correct(ctx, plan, "move"), reading(plan.q_end - 5e-3, plan.q_end))
    assert failure.value.code == "trim_refused"


def test_a_dead_band_is_integrated_away_where_the_move_is_long():
    """Lift and tilt alone carry this move; without the integration they would rest 4 mrad short."""
    ctx, cell, _, plan = paper_plan(-0.05)
    run_plan(drive_and_correct(ctx, plan, "move"), cell)
    lacks = np.abs(plan.q_end - cell.machine.q_encoder)
    assert lacks[1:3].max() < 3e-4
    assert cell.machine.q_ref[1] - plan.q_end[1] == pytest.approx(-4e-3, abs=2e-3)


def test_pairs_that_lack_an_object_are_left_out():
    one = world("paper", 2)
    camera = FastCamera(one, NO_NOISE, rng_for(1, "pairs"))
    pair = camera.pair(QuasiStaticMachine(one).T_base_tcp(), "mono", 0)
    blind = SimpleNamespace(tool=pair.tool, ooi=not_seen("ooi", "hidden"))
    seen = sighted_of([(1.0, pair), (2.0, blind), (3.0, pair)])  # type: ignore[list-item]
    np.testing.assert_array_equal(seen.t_s, [1.0, 3.0])
    np.testing.assert_allclose(seen.vectors_cam[0], pair.ooi.T_cam_object[:3, 3] - pair.tool.T_cam_object[:3, 3])
    assert sighted_of([]).vectors_cam.shape == (0, 3)


class Vision:
    """As much of the vision client as watching needs."""

    def __init__(self) -> None:
        self.callback, self.source = None, "stereo"

    def on_report(self, callback) -> None:
        self.callback = callback

    async def set_pose_source(self, name: str) -> None:
        self.source = name


def test_the_performer_keeps_usable_pairs_between_start_and_stop():
    one = world("paper", 2)
    pair = FastCamera(one, NO_NOISE, rng_for(1, "p")).pair(QuasiStaticMachine(one).T_base_tcp(), "mono", 0)
    sample = SimpleNamespace(t_plc_ns=2_000_000_000, q_rad=tuple(one.q_start_rad))
    link = SimpleNamespace(samples_since=lambda t_ns: [sample, sample], plc_to_pc_offset_ns=1_000_000_000)
    vision = Vision()
    performer = Performer(SimpleNamespace(vision=vision, link=link, chain=chain_of(machine())))  # type: ignore[arg-type]

    def report(t_s: float, usable: bool = True) -> None:
        vision.callback(
            SimpleNamespace(
                fit_for_look=usable, pose_source="mono", t_exposure_mapped_ns=round(1e9 * t_s), observation=pair
            )
        )

    report(1.0)
    asyncio.run(performer.perform(StartWatching("mono")))
    report(2.0)
    report(3.0, usable=False)
    report(4.0)
    sighted, encoder = asyncio.run(performer.perform(StopWatching()))
    report(5.0)
    assert isinstance(sighted, SeenPairs)
    assert vision.source == "mono"
    np.testing.assert_allclose(sighted.t_s, [2.0, 4.0])
    np.testing.assert_allclose(encoder.t_s, [3.0, 3.0])
    again, _ = asyncio.run(performer.perform(StopWatching()))
    assert len(again.t_s) == 0
