"""`python -m benchmarks.identify FOLDER --seed 1 --n 3`: identification drives of drawn machines in virtual time, the
truth beside each; with `--jobs 5` five positioning jobs instead.
"""

import argparse
import dataclasses
import json
import time
from importlib.resources import files
from pathlib import Path

from benchmarks.identify.truth import true_effects
from benchmarks.identify.virtual_cell import recorded_cell, write_recording
from benchmarks.reproduce.fast_cell import context_of, run_plan
from benchmarks.reproduce.noise_model import fitted_noise
from machine.description import parse_machine_toml
from server.jobs.plans.identification_planning import Drive, PlannedIdentification
from server.jobs.plans.identifying import drive_identification, plan_identification
from server.jobs.plans.positioning import position
from server.jobs.plans.returning import return_to_start
from sim_plc.draw_world import draw_world


def record(machine_text: str, preset: str, seed: int, minutes: float, folder: Path) -> None:
    """One drive: FOLDER/recording, FOLDER/truth.json, FOLDER/plan.json."""
    world = draw_world(parse_machine_toml(machine_text), preset, seed)
    cell, ctx = recorded_cell(world, fitted_noise()), context_of(world, "ours")
    kept: list[tuple[Drive, PlannedIdentification]] = []
    plan = plan_identification(ctx, minutes, False, None, lambda *one: kept.append(one), lambda: cell.clock_ns)
    shown = run_plan(plan, cell)
    drive, planned = kept[0]
    start_s = cell.machine.t_s
    driven = run_plan(drive_identification(ctx, planned, drive), cell)
    folder.mkdir(parents=True, exist_ok=True)
    write_recording(cell, machine_text, folder / "recording", start_s)
    truth = {"preset": preset, "seed": seed, "effects": true_effects(world)}
    (folder / "truth.json").write_text(json.dumps(truth, indent=1), encoding="utf-8")
    seconds = round(cell.machine.t_s - start_s, 1)
    summary = {"driven_s": seconds, "driven": dataclasses.asdict(driven), "plan": dataclasses.asdict(shown)}
    (folder / "plan.json").write_text(json.dumps(summary, indent=1), encoding="utf-8")


def record_jobs(machine_text: str, preset: str, seed: int, jobs: int, folder: Path) -> None:
    """Positioning jobs in turn, each from the start and with a calibration: FOLDER/recording/job1 and on."""
    world = draw_world(parse_machine_toml(machine_text), preset, seed)
    cell, ctx = recorded_cell(world, fitted_noise()), context_of(world, "ours")
    for job in range(1, jobs + 1):
        start_s = cell.machine.t_s
        run_plan(position(ctx, True, lambda: cell.clock_ns), cell)
        write_recording(cell, machine_text, folder / "recording" / f"job{job}", start_s)
        run_plan(return_to_start(ctx), cell)
    truth = {"preset": preset, "seed": seed, "effects": true_effects(world)}
    (folder / "truth.json").write_text(json.dumps(truth, indent=1), encoding="utf-8")


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.identify", description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--n", type=int, default=1)
    parser.add_argument("--preset", default="realistic")
    parser.add_argument("--minutes", type=float, default=6.0)
    parser.add_argument("--jobs", type=int, default=0, help="positioning jobs instead of the identification drive")
    given = parser.parse_args()
    text = (files("machine") / "machines" / "hiab033.toml").read_text(encoding="utf-8")
    for seed in range(given.seed, given.seed + given.n):
        t0 = time.monotonic()
        if given.jobs:
            record_jobs(text, given.preset, seed, given.jobs, given.out / f"seed{seed}")
        else:
            record(text, given.preset, seed, given.minutes, given.out / f"seed{seed}")
        print(f"seed {seed}: recorded in {time.monotonic() - t0:.0f} s", flush=True)  # its only output


if __name__ == "__main__":
    main()
