"""A pattern of marks in one job: each is served, reached, and left for the start before the next."""

from types import SimpleNamespace

import numpy as np
import pytest
from test_jobs_plans import World, context, run

from machine.poses import pose
from server.errors import JobFailedError
from server.jobs.plans.pattern import marks_of, visit_marks
from server.jobs.requests import UseTarget
from server.vision.contracts import LookStatus

AWAY_M = (0.0, 0.12, -0.1)


class Wall(World):
    """Marks side by side; the one in use is what a look sees."""

    def __init__(self):
        super().__init__()
        self.first, self.used, self.started_from = self.T_base_ooi, [], []

    def perform(self, request):
        if isinstance(request, UseTarget):
            self.used.append(request.target.target_id)
            self.started_from.append(self.q.copy())
            self.T_base_ooi = self.first @ pose(np.eye(3), np.array([AWAY_M[request.target.target_id], 0.0, 0.0]))
            return None
        return super().perform(request)


@pytest.fixture
def marked(monkeypatch):
    monkeypatch.setattr("server.jobs.plans.seeing.anchor_covariance", lambda target, T: np.zeros((6, 6)))
    world, ctx = Wall(), context()
    ctx.knowledge.found_marks = tuple(SimpleNamespace(target_id=number) for number in range(3))
    return world, ctx


def test_marks_are_reached_in_the_given_order_with_one_calibration(marked) -> None:
    world, ctx = marked
    result, _ = run(visit_marks(ctx, marks_of(ctx, [2, 0, 1]), lambda: world.t_ns), world)
    assert result.reached, result.reason
    assert (result.target_ids, world.used) == ((2, 0, 1), [2, 0, 1])
    assert [("calibrate" in dict(one.seconds_by_step)) for one in result.visits] == [True, False, False]
    assert all(one.reached for one in result.visits)
    assert np.abs(world.error_mm()).max() < 3.0
    for q in world.started_from[1:]:
        assert np.rad2deg(np.abs(q - world.started_from[0])).max() < 1.0


def test_a_failed_look_ends_the_pattern(marked) -> None:
    world, ctx = marked
    world.look_status = LookStatus.OOI_NOT_SEEN
    with pytest.raises(JobFailedError, match="cover is on"):
        run(visit_marks(ctx, marks_of(ctx, [0, 1]), lambda: world.t_ns), world)
    assert world.used == [0]


def test_a_mark_that_is_not_known_is_refused_before_anything_moves(marked) -> None:
    _, ctx = marked
    with pytest.raises(JobFailedError, match=r"\[7\]") as failure:
        marks_of(ctx, [0, 7])
    assert failure.value.code == "no_such_target"
