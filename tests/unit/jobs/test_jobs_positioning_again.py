"""A second positioning job right after the first: what it must leave alone."""

import numpy as np
import pytest
from test_jobs_plans import World, context, run

from machine.poses import pose
from machine.rotations import rotation_from_rotvec
from server.errors import JobFailedError
from server.jobs.plans.positioning import position
from server.jobs.plans.returning import return_to_start
from server.vision.contracts import LookStatus


@pytest.fixture
def done():
    """A world whose tool was brought to the goal, and its context."""
    world, ctx = World(), context()
    result, _ = run(position(ctx, recalibrate=True, clock_ns=lambda: world.t_ns), world)
    assert result.reached
    return world, ctx


def again(world, ctx):
    result, _ = run(position(ctx, recalibrate=True, clock_ns=lambda: world.t_ns), world)
    return result


def test_a_tool_that_is_inside_stays_where_it_is(done) -> None:
    world, ctx = done
    moved, start, mount = world.moved, ctx.knowledge.q_start.copy(), ctx.knowledge.mount_rotation_estimate
    result = again(world, ctx)
    assert result.reached
    assert "after 0 moves" in result.reason
    assert world.moved == moved
    assert ctx.knowledge.mount_rotation_estimate is mount
    assert np.array_equal(ctx.knowledge.q_start, start)


@pytest.mark.parametrize("why", ["no path is possible here", "the look fails"])
def test_what_is_refused_forgets_nothing(done, why: str) -> None:
    world, ctx = done
    start, mount, looks = (
        ctx.knowledge.q_start.copy(),
        ctx.knowledge.mount_rotation_estimate,
        len(ctx.knowledge.look_observations),
    )
    world.T_base_ooi = world.T_base_ooi @ pose(np.eye(3), np.array([0.02, 0.0, 0.0]))
    if why == "the look fails":
        world.look_status = LookStatus.OOI_NOT_SEEN
    moved = world.moved
    with pytest.raises(JobFailedError, match="retract first" if why.startswith("no path") else "cover is on"):
        again(world, ctx)
    assert world.moved == moved
    assert ctx.knowledge.mount_rotation_estimate is mount
    assert len(ctx.knowledge.look_observations) >= looks
    run(return_to_start(ctx), world)
    assert np.abs(world.q - start).max() < np.deg2rad(0.7)  # the stall, on either side


def test_a_run_that_begins_starts_afresh(done) -> None:
    world, ctx = done
    start, mount = ctx.knowledge.q_start.copy(), ctx.knowledge.mount_rotation_estimate
    run(return_to_start(ctx), world)
    world.T_base_ooi = world.T_base_ooi @ pose(rotation_from_rotvec(np.deg2rad([0.0, 1.0, 0.0])), np.zeros(3))
    assert again(world, ctx).reached
    assert ctx.knowledge.mount_rotation_estimate is not mount
    assert np.abs(ctx.knowledge.q_start - start).max() < np.deg2rad(1.0)
