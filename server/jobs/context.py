"""What every plan is given: the nominal machine, the settings and what is known so far."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from machine.chain import Chain
from machine.description import Machine
from machine.kinematics import tcp_pose
from machine.poses import pose
from machine.rotations import Array
from server.compensation.compensation import Compensation
from server.jobs.knowledge import Knowledge
from server.motion.contracts import Wall
from server.motion.lost_motion import first_stall
from server.settings import ServerSettings

Method = Literal["ours", "paper"]


@dataclass(frozen=True, slots=True)
class PlanContext:
    """Frozen inputs of a plan; `knowledge` is where it leaves what it learnt."""

    machine: Machine
    chain: Chain
    settings: ServerSettings
    knowledge: Knowledge
    method: Method = "ours"
    machine_id: str = ""  # of the machine file: a calibration of another one is not used
    compensation: Compensation | None = None  # a diagnosed machine, where the settings name one or a version is in use
    version_id: str = ""  # of the version in use

    def with_method(self, method: Method) -> "PlanContext":
        """The same context for another method."""
        return replace(self, method=method)

    def tcp(self, q_rad: Array) -> Array:
        """T_base_tcp of the nominal model."""
        return tcp_pose(self.chain, q_rad)

    @property
    def stall(self) -> Array:
        """How far each joint rests from its reference (n,) [rad]: as last seen, or a first guess."""
        seen = self.knowledge.stall_rad
        if seen is not None:
            return seen
        guessed = first_stall(self.machine)
        return guessed if self.compensation is None else self.compensation.first_stall(guessed)

    @property
    def T_ooi_goal(self) -> Array:
        """Goal of the tool in the OOI: no rotation, on the normal at the stand-off, shifted by the operator."""
        goal = self.settings.position
        position = np.array([goal.offset_x_mm, goal.offset_y_mm, goal.stand_off_mm]) * 1e-3
        return pose(np.eye(3), position)

    @property
    def wall(self) -> Wall | None:
        """The wall as last seen: the OOI's plane; None before the first look."""
        T_base_ooi = self.knowledge.T_base_ooi
        if T_base_ooi is None:
            return None
        clearance = self.settings.position.wall_clearance_mm * 1e-3
        return Wall(point_base=T_base_ooi[:3, 3], normal_base=T_base_ooi[:3, 2], clearance_min_m=clearance)
