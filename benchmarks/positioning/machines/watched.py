"""Watches a positioning job from outside while it runs: true distances, times, and what it predicted before a move."""

from collections.abc import Generator
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from benchmarks.reproduce.fast_cell import FastCell
from machine.poses import inverse_pose
from machine.rotations import Array
from server.calibration.joint_goal import joints_for_goal
from server.jobs.context import PlanContext
from server.jobs.requests import MachineReading, Move, Progress, Request, Settle, TakeLook

Result = TypeVar("Result")
CALIBRATION = "calibration path"  # the purpose of that move
#: Seconds of a look of 20 pairs beyond its rest, which the fast world takes in no time: 20 rendered runs took 1.8 s for
#: the first look and 2.2 s for the one after the calibration (medians), 0.4 s of it rest.
LOOK_S = 1.6


@dataclass(frozen=True, slots=True)
class LookChange:
    """How a look is taken in place of what the plan asks for; None: as asked."""

    pairs: int | None = None
    mono: bool = False

    def of(self, request: TakeLook) -> TakeLook:
        """The request to make instead."""
        pairs = request.n_pairs if self.pairs is None else self.pairs
        return replace(request, n_pairs=pairs, source="mono" if self.mono else request.source)


@dataclass(slots=True)
class Notes:
    """What was seen. Distances [m] are true ones, of the tool marker; NaN where there was none.

    `covariances`: (3, 3) [mm^2] of the error after each move, predicted before it, OOI axes, by move number.
    `stops_rad`: encoders at rest less where the plan wanted them, after each move.
    """

    looks: int = 0
    last_look_goal_m: float = float("nan")  # from the goal, at the last look before the first move
    last_look_ooi_m: float = float("nan")
    path_goal_m: float = float("nan")  # nearest on any calibration path
    path_ooi_m: float = float("nan")
    rest_s: float = float("nan")  # from the first look to the last rest
    covariances: dict[int, Array] = field(default_factory=dict)
    stops_rad: dict[int, Array] = field(default_factory=dict)


@dataclass(slots=True)
class _Watch:
    cell: FastCell
    ctx: PlanContext
    notes: Notes
    began_s: float
    move: int = 0  # the one that goes on, 0 before the first
    wanted: Array | None = None

    def seconds(self) -> float:
        """Since the first look, looks included."""
        return self.cell.machine.t_s - self.began_s + LOOK_S * self.notes.looks

    def before(self, request: Request) -> None:
        match request:
            case TakeLook():
                self.notes.rest_s = self.seconds()
                self.notes.looks += 1
                if self.move == 0:
                    goal, ooi = _distances(self.cell, self.ctx, self.cell.machine.T_base_tcp()[None])
                    self.notes.last_look_goal_m, self.notes.last_look_ooi_m = float(goal[0]), float(ooi[0])
            case Progress(name="execute"):
                self.move = round(request.current)
                self._predict()
            case _:
                pass

    def _predict(self) -> None:
        """The covariance that the job's own prediction comes from: its records keep the sigmas only."""
        estimate, look = self.ctx.knowledge.joint_estimate, self.ctx.knowledge.last_look
        if self.ctx.settings.position.local_map != "learnt" or look is None:
            return
        if estimate is None or estimate.state is None:
            return
        from_below = np.ones(self.ctx.chain.n)
        found = joints_for_goal(self.ctx.chain, estimate, look.reading.q_rad, self.ctx.T_ooi_goal, side=from_below)
        if found.covariance is not None:
            self.notes.covariances[self.move] = 1e6 * found.covariance[3:, 3:]
            self.wanted = found.q

    def after(self, request: Request, reply: object, began_s: float) -> None:
        if isinstance(request, Move) and request.purpose == CALIBRATION:
            Ts_base_tcp = self.cell.machine.trace(began_s).Ts_base_tcp
            goal, ooi = _distances(self.cell, self.ctx, Ts_base_tcp)
            self.notes.path_goal_m = float(np.fmin(self.notes.path_goal_m, goal.min()))
            self.notes.path_ooi_m = float(np.fmin(self.notes.path_ooi_m, ooi.min()))
        if isinstance(request, Settle) and isinstance(reply, MachineReading) and self.wanted is not None:
            self.notes.stops_rad[self.move] = reply.q_rad - self.wanted


def watched(
    plan: Generator[Request, object, Result], cell: FastCell, ctx: PlanContext, notes: Notes, look: LookChange
) -> Generator[Request, object, Result]:
    """The same plan; `notes` fills up as it goes on, its looks are taken as `look` says."""
    watch = _Watch(cell, ctx, notes, cell.machine.t_s)
    reply: object = None
    while True:
        try:
            request = plan.send(reply)
        except StopIteration as end:
            return end.value
        watch.before(request)
        began_s = cell.machine.t_s
        reply = yield look.of(request) if isinstance(request, TakeLook) else request
        watch.after(request, reply, began_s)


def _distances(cell: FastCell, ctx: PlanContext, Ts_base_tcp: Array) -> tuple[Array, Array]:
    """True distance of the tool marker to its goal and to the OOI's middle, (m,) each."""
    scene = cell.world.scene
    tools = (inverse_pose(scene.T_base_ooi) @ Ts_base_tcp @ scene.T_tcp_tool)[:, :3, 3]
    return np.linalg.norm(tools - ctx.T_ooi_goal[:3, 3], axis=1), np.linalg.norm(tools, axis=1)
