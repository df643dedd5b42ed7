"""`longreach bench servo`: closed-loop control end to end over real UDP and rendered images, joined with truth.

Each seed is positioned as always, retracted along the tool, and brought back while looking.
"""

import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from benchmarks.positioning.end_to_end import READY_S, StepErrors, ends_inside, join_truth, read_truth
from benchmarks.same_options import require_same_options
from longreach.fleet_client import Finished, JobClient, JobRefusedError
from longreach.processes import Stack, StackPorts
from recording.files import write_durably

SETTINGS = "[position]\nclosed_loop = true\n[closed_loop]\nsilence_max_ms = {silence_max_ms}\n"
TRUTH_FLUSH_S = 1.0  # the truth log is flushed twice a second


@dataclass(frozen=True, slots=True)
class ServoCase:
    """One seed: how the closed loop ended, by image and truly; (x, y, z) mm and deg in `steps`."""

    preset: str
    seed: int
    state: str
    code_or_reason: str
    reached: bool
    passes: int
    pairs: int
    corrections: int
    duration_s: float
    steps: list[StepErrors]


def servo(
    n: Annotated[int, typer.Option(help="how many seeds")] = 5,
    seed: Annotated[int, typer.Option(help="first seed")] = 1,
    preset: Annotated[str, typer.Option(help="ideal, realistic or paper")] = "realistic",
    retract_mm: Annotated[float, typer.Option(help="how far it is retracted before it comes back")] = 60.0,
    silence_max_ms: Annotated[float, typer.Option(help="a pair later than this stops the motion")] = 150.0,
    camera_rate_hz: Annotated[float, typer.Option(help="of the simulated camera")] = 15.0,
    folder: Annotated[Path, typer.Option(help="where every case is saved; a second run resumes")] = Path(
        "runs/bench-servo"
    ),
) -> None:
    """Closed-loop control over real UDP and rendered images: does it reach the tolerance, truly."""
    console = Console(width=200)
    require_same_options(folder, retract_mm=retract_mm, silence_max_ms=silence_max_ms, camera_rate_hz=camera_rate_hz)
    settings = folder / "settings.toml"
    settings.write_text(SETTINGS.format(silence_max_ms=silence_max_ms), encoding="utf-8")
    cases = []
    for number in range(seed, seed + n):
        case = _resumed(folder / f"{preset}-{number}.json", preset, number, settings, retract_mm, camera_rate_hz)
        cases.append(case)
        console.print(_line(case))
    console.print(_summary(cases))


def _resumed(path: Path, preset: str, seed: int, settings: Path, retract_mm: float, rate_hz: float) -> ServoCase:
    if path.exists():
        data = json.loads(path.read_text(encoding="utf-8"))
        steps = [StepErrors(**step) for step in data.pop("steps")]
        return ServoCase(**data, steps=steps)
    case = run_case(preset, seed, path.with_suffix(""), settings, retract_mm, rate_hz)
    write_durably(path, json.dumps(asdict(case), indent=1))
    return case


def run_case(preset: str, seed: int, folder: Path, settings: Path, retract_mm: float, rate_hz: float) -> ServoCase:
    """One seed: own processes; position, retract, servo; truth joined afterwards."""
    truth = folder / "truth"
    truth.mkdir(parents=True, exist_ok=True)
    stack = Stack(
        StackPorts.free(),
        preset=preset,
        seed=seed,
        camera_rate_hz=rate_hz,
        truth_log=truth,
        runs_folder=folder / "runs",
        settings_file=settings,
        log_folder=folder / "logs",
    )
    try:
        with stack, JobClient(stack.url) as client:
            client.wait_ready(READY_S)
            before = client.run({"kind": "position", "owner": "bench"})
            if before.state != "done":
                return _failed(preset, seed, f"position {before.state}", before.reason)
            client.run({"kind": "retract", "distance_mm": retract_mm, "owner": "bench"})
            finished = client.run({"kind": "servo", "owner": "bench"})
            time.sleep(TRUTH_FLUSH_S)
    except JobRefusedError as error:
        return _failed(preset, seed, "refused", str(error))
    return _judged(preset, seed, finished, truth)


def _judged(preset: str, seed: int, finished: Finished, truth: Path) -> ServoCase:
    result = finished.result
    if finished.state != "done" or result is None:
        return _failed(preset, seed, finished.state, finished.reason)
    return ServoCase(
        preset=preset,
        seed=seed,
        state=finished.state,
        code_or_reason=result["reason"],
        reached=result["reached"],
        passes=result["passes"],
        pairs=result["pairs"],
        corrections=result["corrections"],
        duration_s=result["duration_s"],
        steps=join_truth(result, read_truth(truth / "truth.csv")),
    )


def _failed(preset: str, seed: int, state: str, reason: str) -> ServoCase:
    return ServoCase(preset, seed, state, reason, False, 0, 0, 0, 0.0, [])


def truly_inside(case: ServoCase) -> bool:
    """Whether it ended truly inside the tolerance."""
    return case.reached and ends_inside(case.steps)


def _line(case: ServoCase) -> str:
    if not case.steps:
        return f"seed {case.seed:4d}  [red]{case.state}[/]: {case.code_or_reason}"
    steps = "  ".join(_step_text(step) for step in case.steps)
    return f"seed {case.seed:4d}  {case.duration_s:4.0f} s  {case.pairs} pairs, {case.corrections} new tails  {steps}"


def _step_text(step: StepErrors) -> str:
    x, y, z = step.true_mm
    return f"{step.name}: true {x:+.1f} {y:+.1f} {z:+.1f} mm {step.true_deg:.2f}°"


def _summary(cases: list[ServoCase]) -> Table:
    table = Table(title=f"closed loop, N = {len(cases)}", title_justify="left", show_header=False)
    table.add_row("ended inside by the image", f"{sum(case.reached for case in cases)} of {len(cases)}")
    table.add_row("truly inside 5 mm and 1 deg", f"{sum(truly_inside(case) for case in cases)} of {len(cases)}")
    lost = sum("invalid look" in case.code_or_reason for case in cases)
    table.add_row("stopped at an invalid look", f"{lost} of {len(cases)}")
    return table
