"""One machine, one run: the paper's two methods and ours in the fast world, with image-based and true errors."""

from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from typing import Literal

from benchmarks.reproduce.error_budget import Change, changed
from benchmarks.reproduce.fast_cell import FastCell, context_of, fast_cell, run_plan
from benchmarks.reproduce.fast_machine import QuasiStaticMachine, TrueMachine
from benchmarks.reproduce.noise_model import NoiseModel
from benchmarks.reproduce.paper_setup import NoSetUpError, beside, nearer
from benchmarks.reproduce.point_sets import PointSets, matched_sets
from benchmarks.reproduce.true_error import StepErrors, Three, euler_deg, true_errors
from machine.description import Machine
from machine.kinematics import tcp_poses
from machine.rotations import Array
from server.calibration.contracts import EncoderTrack
from server.errors import ServerError
from server.jobs.context import PlanContext
from server.jobs.knowledge import LookTaken
from server.jobs.plans.calibrating import calibrate, plan_path
from server.jobs.plans.line import LineVariant, line_run
from server.jobs.plans.looking import good_look
from server.jobs.plans.moving import execute, preview
from server.jobs.plans.orienting import orient
from server.jobs.plans.positioning import position
from server.jobs.records import ErrorMm
from server.jobs.requests import Request
from server.vision.contracts import Look
from sim_plc.draw_world import draw_world
from sim_plc.plant.plant import Plant
from sim_plc.presets import PresetError
from sim_plc.world import World

State = Literal["done", "refused", "no set-up"]
MakeMachine = Callable[[World], TrueMachine]
PAPER_LATE_S = 0.150  # clock offset of preset `paper`: nothing maps the clocks there


@dataclass(frozen=True, slots=True)
class Case:
    """One machine's run. `steps` in order: the looks after orienting and after each move."""

    seed: int
    kind: str
    state: State
    reason: str
    steps: tuple[StepErrors, ...] = ()
    start_mm: Three | None = None  # true tool minus goal at the start, OOI axes
    notes: dict[str, float | str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class FastRun:
    """A case with all behind it, for its pictures. `sets`: Table 3; `reference` (n, 3): planned TCP points [m]."""

    case: Case
    cell: FastCell | None = None
    ctx: PlanContext | None = None
    reference: Array | None = None
    sets: PointSets | None = None


def line_case(
    machine: Machine, seed: int, noise: NoiseModel, variant: LineVariant, make: MakeMachine = QuasiStaticMachine
) -> Case:
    """Table 2: the line equation in preset `paper` at the paper's own set-up."""
    return fast_line_run(machine, seed, noise, variant, make).case


def fast_line_run(
    machine: Machine, seed: int, noise: NoiseModel, variant: LineVariant, make: MakeMachine = QuasiStaticMachine
) -> FastRun:
    """As `line_case`, with all behind it."""
    kind = f"line, {variant}"
    world = _drawn(machine, "paper", seed, beside)
    if isinstance(world, str):
        return FastRun(Case(seed, kind, "no set-up", world))
    cell = fast_cell(world, make(world), noise, PAPER_LATE_S)
    ctx = context_of(world, "paper")
    start = _start(cell, ctx)
    try:
        run = run_plan(line_run(ctx, variant), cell)
    except ServerError as error:
        return FastRun(Case(seed, kind, "refused", str(error), (), start), cell, ctx)
    steps = tuple(_joined(cell, ctx, look.name, look.error, look.t_plc_ns, None) for look in run.looks)
    return FastRun(Case(seed, kind, "done", "", steps, start, {"fit": run.note}), cell, ctx)


def matching_case(
    machine: Machine, seed: int, noise: NoiseModel, moves: int = 2, make: MakeMachine = QuasiStaticMachine
) -> Case:
    """Table 4: the paper's trajectory matching in preset `paper` at its own distance; updates at a held calibration."""
    return fast_matching_run(machine, seed, noise, moves, make).case


def fast_matching_run(
    machine: Machine, seed: int, noise: NoiseModel, moves: int = 2, make: MakeMachine = QuasiStaticMachine
) -> FastRun:
    """As `matching_case`, with all behind it. Table 3's errors are in the case's notes."""
    kind = "matching, paper"
    world = _drawn(machine, "paper", seed, nearer)
    if isinstance(world, str):
        return FastRun(Case(seed, kind, "no set-up", world))
    cell = fast_cell(world, make(world), noise, PAPER_LATE_S)
    ctx = context_of(world, "paper")
    start = _start(cell, ctx)
    looks: list[tuple[str, LookTaken]] = []
    reference: list[Array] = []
    try:
        run_plan(_updates(ctx, moves, looks, reference), cell)
    except ServerError as error:
        return FastRun(Case(seed, kind, "refused", str(error), (), start), cell, ctx)
    steps = tuple(_step(cell, ctx, name, taken) for name, taken in looks)
    track = ctx.knowledge.odometry_runs[-1]
    encoder = EncoderTrack(track.joint_track.t_s, tcp_poses(ctx.chain, track.joint_track.qs))
    sets = matched_sets(track.camera_track, encoder, machine.T_tcp_cam_left[:3, :3])
    return FastRun(Case(seed, kind, "done", "", steps, start, sets.notes()), cell, ctx, reference[0], sets)


def _updates(
    ctx: PlanContext, moves: int, looks: list[tuple[str, LookTaken]], reference: list[Array]
) -> Generator[Request, object, None]:
    """Look, orient, calibrate, then as many look-then-moves as asked for, whatever their errors."""
    taken = yield from good_look(ctx)
    taken = yield from orient(ctx, taken)
    looks.append(("oriented", taken))
    reference.append(plan_path(ctx, taken.reading).Ts_base_tcp[:, :3, 3])
    yield from calibrate(ctx, taken)
    taken = yield from good_look(ctx)
    for number in range(1, moves + 1):
        taken = yield from execute(ctx, preview(ctx, taken, 0), number)
        looks.append((f"move {number}", taken))


def ours_case(
    machine: Machine,
    preset: str,
    seed: int,
    noise: NoiseModel,
    make: MakeMachine = QuasiStaticMachine,
    change: Change | None = None,
) -> Case:
    """The server's default positioning job as it stands, in a preset's own set-up; `change`: for an error budget."""
    kind = f"ours, {preset}"
    world = _drawn(machine, preset, seed, None if change is None else lambda one, _: changed(one, change))
    if isinstance(world, str):
        return Case(seed, kind, "no set-up", world)
    cell = fast_cell(world, make(world), noise)
    ctx = context_of(world, "ours")
    start = _start(cell, ctx)
    try:
        result = run_plan(position(ctx, True, lambda: cell.clock_ns), cell)
    except ServerError as error:
        return Case(seed, kind, "refused", str(error), _moves(cell, ctx), start)
    notes: dict[str, float | str] = {"reached": str(result.reached), "seconds": result.duration_s}
    if result.calibration is not None:
        notes |= {"sigma_deg": result.calibration.sigma_deg, "time_offset_ms": result.calibration.time_offset_ms}
    return Case(seed, kind, "done", result.reason, _moves(cell, ctx), start, notes)


def _moves(cell: FastCell, ctx: PlanContext) -> tuple[StepErrors, ...]:
    """Every orientation step and move that the job has recorded, true errors joined by PLC time."""
    steps = []
    for move in ctx.knowledge.moves:
        name = f"{'move' if move.kind == 'move' else 'orientation'} {move.number}"
        if move.after is not None:
            sigma = move.predicted_sigma_mm if move.kind == "move" else None
            steps.append(_joined(cell, ctx, name, move.after, move.t_rest_plc_ns, sigma))
    return tuple(steps)


def _step(cell: FastCell, ctx: PlanContext, name: str, taken: LookTaken) -> StepErrors:
    if taken.error is None:
        raise ValueError(f"look '{name}' has no error: {taken.record.reason}")
    return _joined(cell, ctx, name, taken.error, taken.record.t_plc_ns, None)


def _joined(
    cell: FastCell, ctx: PlanContext, name: str, image: ErrorMm, t_plc_ns: int, sigma_mm: Three | None
) -> StepErrors:
    true = true_errors(cell.world, cell.true_looks[t_plc_ns], ctx.T_ooi_goal)
    return StepErrors(
        name=name,
        goal_true_mm=true.goal_mm,
        goal_image_mm=(image.x_mm, image.y_mm, image.z_mm),
        camera_true_mm=true.camera_mm,
        camera_image_mm=(image.camera_x_mm, image.camera_y_mm, image.camera_z_mm),
        rotation_true_deg=true.rotation_deg,
        rotation_image_deg=image.rotation_deg,
        predicted_sigma_mm=sigma_mm,
        euler_true_deg=true.euler_deg,
        euler_image_deg=_euler_seen(cell.looks[t_plc_ns]),
    )


def _euler_seen(look: Look) -> Three | None:
    if look.T_cam_tool is None or look.T_cam_ooi is None:
        return None
    return euler_deg(look.T_cam_tool[:3, :3], look.T_cam_ooi[:3, :3])


def _start(cell: FastCell, ctx: PlanContext) -> Three:
    return true_errors(cell.world, cell.machine.T_base_tcp(), ctx.T_ooi_goal).goal_mm


def _drawn(machine: Machine, preset: str, seed: int, place: Callable[[World, Array], World] | None) -> World | str:
    """The world of a seed, its OOI placed anew if asked for; or why there is none."""
    try:
        world = draw_world(machine, preset, seed)
        return world if place is None else place(world, Plant(world.plant, world.q_start_rad).T_base_tcp())
    except (PresetError, NoSetUpError) as error:
        return str(error)
