"""One machine positioned with and without its diagnosed effects, by the rigid map and by the server's own learning."""

import json
from collections.abc import Generator
from dataclasses import asdict, dataclass, replace
from typing import Any

from benchmarks.positioning.compensation.diagnosed import Found, effects_of
from benchmarks.positioning.compensation.tour import toured
from benchmarks.positioning.machines.machine_run import INSIDE_MM
from benchmarks.reproduce.fast_cell import context_of, fast_cell, run_plan
from benchmarks.reproduce.fast_machine import QuasiStaticMachine
from benchmarks.reproduce.noise_model import NoiseModel
from benchmarks.reproduce.true_error import Three, true_errors
from machine.description import Machine
from machine.effects.entries import EffectEntry
from server.compensation.compensation import compensation_of
from server.errors import ServerError
from server.jobs.plans.positioning import position
from server.jobs.records import MoveRecord, PositionResult
from server.jobs.requests import Record, Request
from server.settings import ServerSettings
from sim_plc.draw_world import draw_world
from sim_plc.presets import PresetError
from sim_plc.world import World

STOPS = 24
VARIANTS = {"rigid": "rigid", "rigid + compensation": "rigid", "learnt": "learnt", "learnt + compensation": "learnt"}


@dataclass(frozen=True)
class Reached:
    """Where one variant stood after one move: tool less goal [mm], OOI axes; None with the reason."""

    variant: str
    true_mm: Three | None
    reason: str = ""

    @property
    def inside(self) -> bool:
        """True |x| and |y| inside the tolerance after one move."""
        return self.true_mm is not None and max(abs(self.true_mm[0]), abs(self.true_mm[1])) <= INSIDE_MM


@dataclass(frozen=True)
class Compared:
    """One machine: what its diagnosis came to, and every variant."""

    seed: int
    verdict: str
    closed_frac: float
    why: str
    compensated: bool
    effects: list[str]
    reached: list[Reached]

    def of(self, variant: str) -> Reached | None:
        """One variant's run."""
        return next((one for one in self.reached if one.variant == variant), None)

    def to_line(self) -> str:
        """For a JSON-lines file."""
        return json.dumps(asdict(self))

    @staticmethod
    def of_line(text: str) -> "Compared":
        """From a line.

        Raises: ValueError, KeyError, TypeError: cut off, or of another version.
        """
        data: dict[str, Any] = json.loads(text)
        reached = [
            Reached(one["variant"], None if one["true_mm"] is None else tuple(one["true_mm"]), one["reason"])
            for one in data["reached"]
        ]
        return Compared(**{**data, "reached": reached})


def compare(machine: Machine, text: str, noise: NoiseModel, seed: int, preset: str = "realistic") -> Compared | None:
    """Record, diagnose, then position four times from the same start; None where no scene can be drawn.

    A diagnosis that is not usable is not compensated: its machine runs as without, and counts.
    """
    try:
        world = draw_world(machine, preset, seed)
    except PresetError:
        return None
    found = effects_of(*(toured(world, noise, text, STOPS, number) for number in range(3)))
    reached = [_run(world, noise, name, found) for name in VARIANTS]
    told = [f"{one.name} {one.joint or ''}".strip() for one in found.effects]
    return Compared(seed, found.verdict, found.closed_frac, found.why, found.usable, told, reached)


def until_first_move(plan: Generator[Request, object, PositionResult]) -> Generator[Request, object, None]:
    """The same plan, closed once its first move is on record: every variant keeps the moves it counts on."""
    reply: object = None
    while True:
        try:
            request = plan.send(reply)
        except StopIteration:
            return
        reply = yield request
        if isinstance(request, Record) and isinstance(request.item, MoveRecord) and request.item.kind == "move":
            plan.close()
            return


def _run(world: World, noise: NoiseModel, variant: str, found: Found) -> Reached:
    """One positioning job, up to where it stands after its first move (or where it ends without one)."""
    settings = ServerSettings.model_validate({"position": {"local_map": VARIANTS[variant]}})
    cell, ctx = fast_cell(world, QuasiStaticMachine(world), noise), context_of(world, "ours", settings)
    if variant.endswith("compensation"):
        effects: tuple[EffectEntry, ...] = found.effects if found.usable else ()
        ctx = replace(ctx, compensation=compensation_of(world.nominal, effects) if effects else None)
    try:
        run_plan(until_first_move(position(ctx, True, lambda: cell.clock_ns)), cell)
    except ServerError as error:
        return Reached(variant, None, str(error))
    return Reached(variant, true_errors(world, cell.machine.T_base_tcp(), ctx.T_ooi_goal).goal_mm)
