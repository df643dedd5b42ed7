"""The method with one improvement taken away at a time.

The product has no switches for these: the bench replaces the function that a plan calls, for the length of one run.
A name that is not there any more fails at once, so a variant cannot silently become the default.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.positioning.machines.watched import LookChange
from machine.description import Machine
from machine.rotations import Array
from server.calibration.joint_estimate import JointPrior
from server.calibration.kinematic_errors import ErrorPrior
from server.jobs.plans import driving, learning, planning
from server.motion import calibration_paths
from server.motion.contracts import JointTrajectory, PathPlan, Wall
from server.motion.point_to_point import plan_move
from server.motion.settings import PlanSettings

NONE6 = (0.0,) * 6
KNOWN = 1e-9  # a standard deviation of what is taken for known
UNKNOWN_RAD, UNKNOWN_M = 1.0, 0.3


@dataclass(frozen=True, slots=True)
class Replacement:
    """A function of a module that another one stands in for."""

    module: Any
    name: str
    by: Callable[..., Any]


@dataclass(frozen=True, slots=True)
class Variant:
    """How a run differs from the default: settings of `[position]`, the look, functions replaced."""

    name: str
    what: str
    position: tuple[tuple[str, Any], ...] = ()
    look: LookChange = field(default_factory=LookChange)
    replaced: tuple[Replacement, ...] = ()


@contextmanager
def applied(variant: Variant) -> Iterator[None]:
    """The variant's replacements in place, and taken back at the end.

    Raises: AttributeError: a name that its module does not have.
    """
    with ExitStack() as undo:
        for one in variant.replaced:
            undo.callback(setattr, one.module, one.name, getattr(one.module, one.name))
            setattr(one.module, one.name, one.by)
        yield


def _believing(prior: JointPrior) -> tuple[Replacement, ...]:
    """The joint estimate with another prior."""
    return (Replacement(learning, "JointPrior", lambda: prior),)


def _circle() -> Array:
    """Corners (13, 3) [m] of a plain circle about as long as the folded path, parallel to the wall."""
    radius = 1.0 / (2.0 * np.pi)
    turn = np.linspace(0.0, 2.0 * np.pi, 13)
    return np.column_stack([radius * np.cos(turn) - radius, radius * np.sin(turn), np.zeros(13)])


def _held_reference(trajectory: JointTrajectory, q_ref_now: Array, stall_rad: Array) -> JointTrajectory:
    """The path shifted as it is onto the reference: no stall is taken out."""
    del stall_rad
    offset = q_ref_now - trajectory.q[0]
    return JointTrajectory(trajectory.t_s, trajectory.q + offset, trajectory.qd, trajectory.qdd)


def _from_any_side(
    machine: Machine, q: Array, T_base_tcp: Array, settings: PlanSettings, wall: Wall | None, q_goal: Array | None
) -> PathPlan:
    del q_goal
    return plan_move(machine, q, T_base_tcp, settings, wall)


def _never(machine: object, q: Array, residual: Array) -> Array:
    del machine, q
    return np.zeros(len(residual), dtype=bool)


DEFAULT = Variant("default", "as the server comes")

ABLATIONS: tuple[Variant, ...] = (
    Variant("rigid map", "a rotation between camera and base in place of the learnt map", (("local_map", "rigid"),)),
    Variant(
        "no play", "play of slew and wrists not in the estimate",
        replaced=_believing(JointPrior(kinematic_errors=ErrorPrior(mean_play_rad=NONE6, sigma_play_rad=NONE6))),
    ),
    Variant(
        "no sag", "compliance of the booms not in the estimate",
        replaced=_believing(JointPrior(kinematic_errors=ErrorPrior(mean_compliance=NONE6, sigma_compliance=NONE6))),
    ),
    Variant(
        "no lengths and zeros", "the machine file's lengths, twists and zeros taken for true",
        replaced=_believing(
            JointPrior(kinematic_errors=ErrorPrior(sigma_a_m=(0.0,), sigma_d_m=(0.0,), sigma_twist_rad=0.0,
                sigma_zero_rad=0.0))
        ),
    ),
    Variant("no time offset", "clocks taken for mapped", replaced=_believing(JointPrior(sigma_time_s=KNOWN))),
    Variant(
        "no tool marker prior", "tool marker on the TCP unknown",
        replaced=_believing(JointPrior(sigma_tool_marker_rad=UNKNOWN_RAD, sigma_tool_marker_m=UNKNOWN_M)),
    ),
    Variant("single pair", "one stereo pair a look in place of 20", look=LookChange(pairs=1)),
    Variant("mono look", "the left eye alone, 20 frames", look=LookChange(mono=True)),
    Variant("mono, single frame", "the left eye alone, one frame, as the paper", look=LookChange(pairs=1, mono=True)),
    Variant(
        "any side", "no last leg from below",
        replaced=(Replacement(planning, "plan_approach", _from_any_side),),
    ),
    Variant("circle", "a plain circle in place of the folded path", replaced=(
        Replacement(calibration_paths, "folded_corners", _circle),
    )),
    Variant("paper's path", "the paper's planar, line-like path", replaced=(
        Replacement(calibration_paths, "folded_corners", calibration_paths.paper_corners),
    )),
    Variant("no trims", "encoders left where they stop", replaced=(Replacement(driving, "worth_trimming", _never),)),
    Variant("no stall map", "dead bands not taken out of the reference on the way", replaced=(
        Replacement(planning, "shifted", _held_reference),
    )),
    Variant("one orientation step", "never a second one", (("orientation_steps_max", 1),)),
    Variant("no orientation step", "moves turn the tool on the way", (("orientation_steps_max", 0),)),
)  # fmt: skip
