"""What a motion that is steered by pairs says when it cannot believe one: value, limit, unit and what to do."""

from types import SimpleNamespace

import numpy as np

from server.jobs.plans import steering_path
from server.jobs.plans.steering_path import off_goal


def test_a_goal_that_jumps_names_how_far_what_is_allowed_and_what_to_do(monkeypatch):
    monkeypatch.setattr(steering_path, "_goal_seen", lambda *_: (np.eye(4), 0.001, 0.5))
    steered = SimpleNamespace(seen_goal=SimpleNamespace(jump_and_limit=lambda *_: (0.0253, 0.019)), n_pairs=0)
    told = off_goal(None, steered, None)
    assert told.startswith("the goal jumped by 25.3 mm (limit 19.0 mm, 500 mm before it); look whether")
    assert steered.n_pairs == 0
