"""One machine: the server's own positioning job in the fast world, watched, with true errors and predictions."""

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from benchmarks.positioning.machines.variants import Variant, applied
from benchmarks.positioning.machines.watched import LookChange, Notes, watched
from benchmarks.reproduce.cases import MakeMachine
from benchmarks.reproduce.error_budget import SOURCES, Change
from benchmarks.reproduce.fast_cell import FastCell, context_of, fast_cell, run_plan
from benchmarks.reproduce.fast_machine import QuasiStaticMachine
from benchmarks.reproduce.noise_model import NoiseModel
from benchmarks.reproduce.true_error import Three, true_errors
from machine.description import Machine
from server.errors import ServerError
from server.jobs.context import PlanContext
from server.jobs.plans.moving import execute, preview
from server.jobs.plans.positioning import position
from server.jobs.plans.returning import return_to_start
from server.settings import ServerSettings
from sim_plc.draw_world import draw_world
from sim_plc.presets import PresetError
from sim_plc.world import World

INSIDE_MM, LOOK_MIN_M, PATH_MIN_M = 5.0, 0.30, 0.25


@dataclass(frozen=True, slots=True)
class MoveErrors:
    """At rest after one move: tool less goal, OOI axes, and what was predicted before it."""

    true_mm: Three
    image_mm: Three
    true_deg: float
    sigma_mm: Three
    covariance_mm2: list[list[float]] | None
    length_mm: float
    trims: int
    stop_rad: list[float] | None  # encoders at rest less where the estimate wanted them


@dataclass(frozen=True, slots=True)
class MachineRun:
    """One machine. `state`: done, refused (with the reason) or undrawn; distances as in `Notes`."""

    seed: int
    preset: str
    variant: str
    state: str
    reason: str
    moves: list[MoveErrors] = field(default_factory=list)
    start_mm: Three | None = None
    oriented_mm: Three | None = None
    last_look_goal_m: float = float("nan")
    last_look_ooi_m: float = float("nan")
    path_goal_m: float = float("nan")
    path_ooi_m: float = float("nan")
    rest_s: float = float("nan")
    second: MoveErrors | None = None  # where only one move was needed: after a second one made anyway
    warning: str = ""  # of the calibration: what it found against camera and prints
    reached: bool = False
    end_true_mm: Three | None = None
    end_image_mm: Three | None = None  # the job's last look, and its sigmas
    end_sigma_mm: Three | None = None
    again_state: str = ""
    again_rest_s: float = float("nan")  # the same goal again from the start, with the calibration kept

    @property
    def obeys(self) -> bool:
        """Whether the last look before the first move and the calibration path kept their distances from the goal."""
        return bool(self.last_look_goal_m >= LOOK_MIN_M and self.path_goal_m >= PATH_MIN_M)

    def after(self, moves: int) -> MoveErrors | None:
        """Where it stood within that many moves: a job that needed fewer stays where it is."""
        return self.moves[min(moves, len(self.moves)) - 1] if self.moves else None

    def after_two_made(self) -> MoveErrors | None:
        """Where it stood after two moves, the second made whether it was needed or not."""
        return self.moves[1] if len(self.moves) > 1 else self.second

    def inside(self, moves: int, limit_mm: float = INSIDE_MM) -> bool:
        """Whether true |x| and |y| are inside after that many moves; a refused job is not, whenever it was refused."""
        step = self.after(moves)
        return self.state == "done" and step is not None and max(abs(v) for v in step.true_mm[:2]) <= limit_mm

    def to_dict(self) -> dict[str, Any]:
        """For a JSON line."""
        return asdict(self)

    @staticmethod
    def from_dict(data: dict[str, Any]) -> "MachineRun":
        """From a JSON line.

        Raises: TypeError: of another version.
        """
        moves = [MoveErrors(**one) for one in data["moves"]]
        second = None if data.get("second") is None else MoveErrors(**data["second"])
        return MachineRun(**{**data, "moves": moves, "second": second})


def run_machine(
    machine: Machine,
    preset: str,
    seed: int,
    noise: NoiseModel,
    variant: Variant,
    again: bool = False,
    make: MakeMachine = QuasiStaticMachine,
    change: Change = SOURCES["as drawn"],
) -> MachineRun:
    """The default positioning job on the machine of a preset and seed.

    Args:    again: drive back to the start and position once more without calibrating, for its time.
             make: the quasi-static machine, or the fine plant. change: of the drawn world.
    """
    try:
        world = change(draw_world(machine, preset, seed))
    except PresetError as error:
        return MachineRun(seed, preset, variant.name, "undrawn", str(error))
    settings = ServerSettings.model_validate({"position": dict(variant.position)})
    cell, ctx = fast_cell(world, make(world), noise), context_of(world, "ours", settings)
    with applied(variant):
        return _run(world, cell, ctx, variant, again)


def _run(world: World, cell: FastCell, ctx: PlanContext, variant: Variant, again: bool) -> MachineRun:
    notes, state, reason, result = Notes(), "done", "", None
    start = true_errors(world, cell.machine.T_base_tcp(), ctx.T_ooi_goal).goal_mm
    try:
        plan = position(ctx, True, lambda: cell.clock_ns)
        result = run_plan(watched(plan, cell, ctx, notes, variant.look), cell)
        reason = result.reason
    except ServerError as error:
        state, reason = "refused", str(error)
    moves, oriented = _moves(world, cell, ctx, notes)
    end = None if result is None else result.end
    warning = "" if ctx.knowledge.calibration_record is None else ctx.knowledge.calibration_record.reason
    end_true = true_errors(world, cell.machine.T_base_tcp(), ctx.T_ooi_goal).goal_mm
    second, again_state, again_rest_s = None, "", float("nan")
    if again and state == "done":
        second = _second(world, cell, ctx) if len(moves) == 1 else None
        again_state, again_rest_s = _again(cell, ctx, variant.look)
    return MachineRun(
        seed=world.seed,
        preset=world.preset,
        variant=variant.name,
        state=state,
        reason=reason,
        moves=moves,
        start_mm=start,
        oriented_mm=oriented,
        last_look_goal_m=notes.last_look_goal_m,
        last_look_ooi_m=notes.last_look_ooi_m,
        path_goal_m=notes.path_goal_m,
        path_ooi_m=notes.path_ooi_m,
        rest_s=notes.rest_s,
        second=second,
        warning=warning,
        reached=result is not None and result.reached,
        end_true_mm=end_true,
        end_image_mm=None if end is None else (end.x_mm, end.y_mm, end.z_mm),
        end_sigma_mm=None if end is None else (end.sigma_x_mm, end.sigma_y_mm, end.sigma_z_mm),
        again_state=again_state,
        again_rest_s=again_rest_s,
    )


def _second(world: World, cell: FastCell, ctx: PlanContext) -> MoveErrors | None:
    """One more look-then-move from the last look, with what was learnt; None where it is refused."""
    taken, number = ctx.knowledge.last_look, len(ctx.knowledge.moves) + 1
    if taken is None:
        return None
    try:
        run_plan(execute(ctx, preview(ctx, taken, cell.clock_ns), number), cell)
    except ServerError:
        return None
    moves, _ = _moves(world, cell, ctx, Notes())
    return moves[-1]


def _again(cell: FastCell, ctx: PlanContext, look: LookChange) -> tuple[str, float]:
    notes = Notes()
    try:
        run_plan(return_to_start(ctx), cell)
        run_plan(watched(position(ctx, False, lambda: cell.clock_ns), cell, ctx, notes, look), cell)
    except ServerError as error:
        return f"refused: {error}", float("nan")
    return "done", notes.rest_s


def _moves(world: World, cell: FastCell, ctx: PlanContext, notes: Notes) -> tuple[list[MoveErrors], Three | None]:
    """The recorded moves joined with the truth by PLC time, and the true error after the last orientation step."""
    found: list[MoveErrors] = []
    oriented = None
    for move in ctx.knowledge.moves:
        true = true_errors(world, cell.true_looks[move.t_rest_plc_ns], ctx.T_ooi_goal)
        if move.kind != "move":
            oriented = true.goal_mm
        elif move.after is not None:
            covariance, stop = notes.covariances.get(move.number), notes.stops_rad.get(move.number)
            found.append(
                MoveErrors(
                    true_mm=true.goal_mm,
                    image_mm=(move.after.x_mm, move.after.y_mm, move.after.z_mm),
                    true_deg=true.rotation_deg,
                    sigma_mm=move.predicted_sigma_mm,
                    covariance_mm2=None if covariance is None else np.round(covariance, 5).tolist(),
                    length_mm=move.length_mm,
                    trims=move.trims,
                    stop_rad=None if stop is None else np.round(stop, 7).tolist(),
                )
            )
    return found, oriented
