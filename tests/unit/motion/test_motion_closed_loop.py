"""The closed loop and experiments refuse what every other motion refuses, and ask where the joints really rest."""

from dataclasses import dataclass
from itertools import product

import numpy as np
import pytest

from machine.chain import chain_of
from machine.kinematics import tcp_poses
from server.jobs.context import PlanContext
from server.jobs.knowledge import Knowledge
from server.jobs.plans.steering_path import TURN_MAX_RAD, path_onto_reference
from server.jobs.requests import MachineReading
from server.motion.closed_loop import at_rest, path_to_rest, reference_goal
from server.motion.contracts import JointTrajectory, PlanStatus, Wall
from server.motion.refusal import Refusal
from server.motion.wall_clearance import clearances, stall_reach, wall_refusal
from server.settings import ServerSettings, read_machine

MACHINE = read_machine("hiab033")
CHAIN = chain_of(MACHINE)
Q = np.deg2rad([0.0, 20.0, -60.0, 0.0, 40.0, 0.0])


@dataclass(frozen=True, slots=True)
class Seeing(PlanContext):
    """A context that knows this wall."""

    wall_seen: Wall | None = None

    @property
    def wall(self) -> Wall | None:
        return self.wall_seen


@pytest.mark.parametrize("pitch_deg", [(11.0, 8.9), (11.0, -12.0), (6.0, 5.0)])
def test_the_wrists_singularity_is_refused_as_by_every_other_motion(pitch_deg):
    start, goal = (np.where(np.arange(6) == 4, np.deg2rad(deg), Q) for deg in pitch_deg)
    found = path_to_rest(MACHINE, CHAIN, at_rest(start), goal, 0.02, 0.5, None)
    assert isinstance(found, Refusal)
    assert found.status is PlanStatus.SINGULAR


def test_an_ordinary_path_is_none():
    found = path_to_rest(MACHINE, CHAIN, at_rest(Q), Q + 0.01, 0.02, 0.5, None)
    assert isinstance(found, JointTrajectory)


def test_a_wrist_that_would_swing_round_for_a_few_centimetres_is_refused():
    ctx = PlanContext(MACHINE, CHAIN, ServerSettings(), Knowledge())
    reading = MachineReading(Q, Q, 0, 0)
    goal = Q + np.array([0.0, 0.0, 0.0, 1.2 * TURN_MAX_RAD, 0.0, -1.2 * TURN_MAX_RAD])
    found = path_onto_reference(ctx, at_rest(Q), reading, goal, 0.5)
    assert isinstance(found, Refusal)
    assert "too near to a singularity" in found.reason


def test_the_joints_own_way_is_held_off_the_wall_and_not_only_the_references():
    """The lift goes up and rests below its reference, the tilt goes down with a shorter lever."""
    stall = np.array([0.0, 0.01, 0.002, 0.0, 0.0, 0.0])
    goal, normal = Q + np.array([0.0, 0.02, -0.08, 0.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    floor = Wall(np.zeros(3), normal, 0.05)
    rests_m = clearances(tcp_poses(CHAIN, goal[None]), MACHINE.T_tcp_tool, floor)[0]
    wall = Wall(np.array([0.0, 0.0, rests_m - 0.045]), normal, 0.05)  # 45 mm from where the joints rest
    knowledge = Knowledge()
    knowledge.stall_rad = stall
    reading = MachineReading(Q, Q + stall * [0, -1, 1, 0, 0, 0], 0, 0)
    start, q_ref = at_rest(reading.q_ref_rad), reference_goal(goal, Q, reading.q_ref_rad, stall)
    assert isinstance(path_to_rest(MACHINE, CHAIN, start, q_ref, 0.02, 0.5, wall), JointTrajectory)
    found = path_onto_reference(
        Seeing(MACHINE, CHAIN, ServerSettings(), knowledge, wall_seen=wall), start, reading, goal, 0.5
    )
    assert isinstance(found, Refusal)
    assert found.status is PlanStatus.WALL


def test_what_a_stall_may_bring_the_tool_nearer_by_is_the_worst_of_all_sides():
    stall, normal = np.array([0.0, 0.01, 0.008, 0.004, 0.004, 0.004]), np.array([0.6, 0.0, 0.8])
    wall = Wall(np.zeros(3), normal, 0.05)
    reach = stall_reach(CHAIN, Q[None], stall, wall)[0]
    tips = [
        tcp_poses(CHAIN, (Q + np.array(side) * stall)[None])[0, :3, 3] @ normal for side in product((-1, 1), repeat=6)
    ]
    here = tcp_poses(CHAIN, Q[None])[0, :3, 3] @ normal
    assert reach == pytest.approx(here - min(tips), rel=0.02)
    Ts = tcp_poses(CHAIN, np.array([Q, Q]))
    Ts[0, :3, 3] += 0.2 * normal
    near = Wall(Ts[1, :3, 3] - (0.05 + 0.5 * reach) * normal, normal, 0.05)
    tool = np.eye(4)
    assert wall_refusal(Ts, tool, near)[1] is None
    assert wall_refusal(Ts, tool, near, np.array([reach, reach]))[1] is not None
