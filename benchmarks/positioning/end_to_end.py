"""`longreach bench position`: seeds of a preset, end to end over real UDP and images, then joined with truth.

The server never sees the truth: sim_plc logs it by PLC time, the result of the job names the PLC time of each look,
and here, after the run, the two are joined.
"""

import csv
import json
import statistics
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from longreach.fleet_client import JobClient, JobRefusedError
from longreach.processes import Stack, StackPorts
from recording.files import write_durably

PAPER_TABLE_4 = {"move 1": (7.6, 27.4, 95.9), "move 2": (3.3, 1.2, 92.3)}  # means, z with b = 100 mm
READY_S = 180.0
REST_NS = 300_000_000  # a look's time ends at least 0.32 s of rest; after it the next motion may begin at once
TRUTH_COLUMNS = ("error_x_mm", "error_y_mm", "error_z_mm", "error_rotation_deg")


@dataclass(frozen=True, slots=True)
class StepErrors:
    """Image-based and true error at the look after one step; (x, y, z) mm and rotation deg."""

    name: str
    image_mm: tuple[float, float, float]
    image_deg: float
    true_mm: tuple[float, float, float]
    true_deg: float
    camera_mm: tuple[float, float, float]  # OOI minus tool in camera axes, z with the stand-off: as the paper's tables


@dataclass(frozen=True, slots=True)
class Case:
    """One seed's run."""

    preset: str
    method: str
    seed: int
    state: str
    reason: str
    reached: bool
    moves: int
    duration_s: float
    seconds_by_step: list[tuple[str, float]]
    calibration: dict[str, Any] | None
    steps: list[StepErrors]


def run_case(preset: str, method: str, seed: int, folder: Path) -> Case:
    """One seed: own processes, one positioning job, truth joined afterwards."""
    case_folder = folder / f"{preset}-{method}-{seed}"
    truth_folder = case_folder / "truth"
    truth_folder.mkdir(parents=True, exist_ok=True)
    stack = Stack(
        StackPorts.free(),
        preset=preset,
        seed=seed,
        truth_log=truth_folder,
        runs_folder=case_folder / "runs",
        log_folder=case_folder / "logs",
    )
    started = time.monotonic()
    try:
        with stack, JobClient(stack.url) as client:
            client.wait_ready(READY_S)
            started = time.monotonic()
            finished = client.run({"kind": "position", "method": method, "owner": "bench"})
            time.sleep(0.3)  # the truth log is flushed twice a second
    except JobRefusedError as error:
        return Case(preset, method, seed, "refused", str(error), False, 0, time.monotonic() - started, [], None, [])
    result = finished.result if finished.state == "done" else None
    if result is None:
        return Case(preset, method, seed, finished.state, finished.reason, False, 0, finished.elapsed_s, [], None, [])
    steps = join_truth(result, read_truth(truth_folder / "truth.csv"))
    moves = sum(move["kind"] == "move" for move in result["moves"])
    return Case(
        preset=preset,
        method=method,
        seed=seed,
        state=finished.state,
        reason=result["reason"],
        reached=result["reached"],
        moves=moves,
        duration_s=result["duration_s"],
        seconds_by_step=result["seconds_by_step"],
        calibration=result["calibration"],
        steps=steps,
    )


def read_truth(path: Path) -> dict[str, np.ndarray]:
    """Columns of the simulator's truth log: PLC time [ns] and the true errors."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if all(row.get(name) for name in TRUTH_COLUMNS)]
    columns = {name: np.array([float(row[name]) for row in rows]) for name in TRUTH_COLUMNS}
    columns["t_plc_ns"] = np.array([int(row["t_plc_ns"]) for row in rows])
    return columns


def join_truth(result: dict[str, Any], truth: dict[str, np.ndarray]) -> list[StepErrors]:
    """Each look of the result beside the true error over the 0.3 s before it, when the machine was at rest."""
    looks = [("start", result["start"], result["t_start_plc_ns"])]
    for move in result["moves"]:
        name = f"{move['kind']} {move['number']}"
        looks.append((name, move["after"], move["t_rest_plc_ns"]))
    steps = []
    for name, image, t_plc_ns in looks:
        before = resting(truth["t_plc_ns"], t_plc_ns)
        x, y, z, rotation = (float(truth[column][before].mean()) for column in TRUTH_COLUMNS)
        image_mm = (image["x_mm"], image["y_mm"], image["z_mm"])
        camera_mm = (image["camera_x_mm"], image["camera_y_mm"], image["camera_z_mm"])
        steps.append(StepErrors(name, image_mm, image["rotation_deg"], (x, y, z), rotation, camera_mm))
    return steps


def resting(t_plc_ns: np.ndarray, t_look_ns: int) -> np.ndarray:
    """Which rows of a truth log (n,) [ns] tell where the machine stood at a look: those of its rest before it."""
    before_ns = t_look_ns - t_plc_ns
    return (before_ns >= 0) & (before_ns < REST_NS)


def bench(preset: str, method: str, n: int, seed: int, folder: Path, console: Console) -> list[Case]:
    """Run or resume n seeds from `seed` on; every case is saved as soon as it is there."""
    folder.mkdir(parents=True, exist_ok=True)
    cases = []
    for number in range(seed, seed + n):
        saved = folder / f"{preset}-{method}-{number}.json"
        if saved.exists():
            case = _load(saved)
        else:
            with console.status(f"seed {number} ({number - seed + 1} of {n})"):
                case = run_case(preset, method, number, folder)
            write_durably(saved, json.dumps(asdict(case), indent=1))
        cases.append(case)
        console.print(_line(case))
    return cases


def _load(path: Path) -> Case:
    data = json.loads(path.read_text(encoding="utf-8"))
    steps = [StepErrors(**step) for step in data.pop("steps")]  # lists where tuples were: read as sequences only
    return Case(**data, steps=steps)


def _line(case: Case) -> str:
    if not case.steps:
        return f"seed {case.seed:4d}  [red]{case.state}[/] after {case.duration_s:.0f} s: {case.reason}"
    parts = []
    for step in case.steps:
        x, y, z = step.true_mm
        xi, yi, zi = step.image_mm
        parts.append(
            f"{step.name}: true {x:+.1f} {y:+.1f} {z:+.1f} mm {step.true_deg:.2f}° "
            f"(image {xi:+.1f} {yi:+.1f} {zi:+.1f} {step.image_deg:.2f}°)"
        )
    return f"seed {case.seed:4d}  {case.duration_s:4.0f} s  " + "  ".join(parts)


def inside(case: Case, moves_max: int, limit_mm: float = 5.0, limit_deg: float = 1.0) -> bool:
    """Whether the run ended truly inside the limits within that many moves."""
    return case.reached and case.moves <= moves_max and ends_inside(case.steps, limit_mm, limit_deg)


def inside_after(case: Case, moves: int, limit_mm: float = 5.0, limit_deg: float = 1.0) -> bool:
    """Whether the tool was truly inside at rest after that move, or where the job ended before it.

    A job that cannot yet be sure moves again although it is inside; this counts where the machine stood, not its doubt.
    """
    made = {step.name: step for step in case.steps}
    last = next((made[f"move {k}"] for k in range(moves, 0, -1) if f"move {k}" in made), None)
    return last is not None and ends_inside([last], limit_mm, limit_deg)


def ends_inside(steps: list[StepErrors], limit_mm: float = 5.0, limit_deg: float = 1.0) -> bool:
    """Whether the last step was truly inside the limits; without steps nothing was."""
    return bool(steps) and max(map(abs, steps[-1].true_mm)) <= limit_mm and steps[-1].true_deg <= limit_deg


def pattern_of_paper(case: Case) -> bool:
    """Table 4's pattern by the image, as the paper measured: |y| > 10 mm after move 1, x and y < 5 mm after move 2."""
    steps = {step.name: step for step in case.steps}
    if "move 1" not in steps or "move 2" not in steps:
        return False
    first, second = steps["move 1"].camera_mm, steps["move 2"].camera_mm
    return abs(first[1]) > 10.0 and abs(second[0]) < 5.0 and abs(second[1]) < 5.0


def summary(cases: list[Case]) -> Table:
    """Mean absolute errors after each move, image-based and true, beside the paper's Table 4."""
    table = Table(title=f"mean |error| over N = {len(cases)}", title_justify="left")
    for heading in (
        "after",
        "N",
        "image x y z mm",
        "true x y z mm",
        "true rotation deg",
        "camera axes",
        "paper, camera axes",
    ):
        table.add_column(heading)
    for name in ("start", "orientation 1", "orientation 2", "move 1", "move 2", "move 3", "move 4"):
        steps = [step for case in cases for step in case.steps if step.name == name]
        if not steps:
            continue
        image = np.abs([step.image_mm for step in steps]).mean(axis=0)
        true = np.abs([step.true_mm for step in steps]).mean(axis=0)
        rotation = statistics.mean(step.true_deg for step in steps)
        paper = PAPER_TABLE_4.get(name)
        camera = np.abs([step.camera_mm for step in steps]).mean(axis=0)
        row = [name, str(len(steps)), _three(image), _three(true), f"{rotation:.2f}", _three(camera)]
        table.add_row(*row, _three(np.array(paper)) if paper else "")
    return table


def _three(values: np.ndarray) -> str:
    return " ".join(f"{value:6.1f}" for value in values)
