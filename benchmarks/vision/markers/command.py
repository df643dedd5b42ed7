"""`longreach bench markers`: how near marker poses come to the bound, flips, and whether covariances are honest."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from enum import Enum
from pathlib import Path
from typing import Annotated, Any

import cv2
import typer
from rich.console import Console
from rich.progress import track

from benchmarks.same_options import require_same_options, text_mark
from benchmarks.vision.markers.cells import Cell, grid
from benchmarks.vision.markers.exact import run_cell
from benchmarks.vision.markers.images import SensorSettings, Studio
from benchmarks.vision.markers.judged import CellResult
from benchmarks.vision.markers.rendered import RenderedCell, run_rendered_cell, settings_name
from benchmarks.vision.markers.tables import exact_lines, exact_table, rendered_lines, rendered_table
from recording.files import write_durably
from server.settings import read_machine, read_machine_text

console = Console(width=200)


class Mode(Enum):
    """Where the corners come from."""

    EXACT = "exact"
    RENDERED = "rendered"


def markers(
    n: Annotated[int, typer.Option(help="looks per cell; 0: 200 exact or 20 rendered ones")] = 0,
    seed: Annotated[int, typer.Option(help="seed")] = 1,
    mode: Annotated[Mode, typer.Option(help="exact projections with noise, or rendered images")] = Mode.EXACT,
    noise_grey: Annotated[float, typer.Option(help="rendered: noise at mid grey")] = 2.0,
    psf_px: Annotated[float, typer.Option(help="rendered: point spread, one sigma")] = 0.6,
    jpeg: Annotated[int, typer.Option(help="rendered: JPEG quality; 0: none")] = 0,
    machine: Annotated[str, typer.Option(help="machine file or name")] = "hiab033",
    folder: Annotated[Path, typer.Option(help="where every cell is saved; a second run resumes")] = Path(
        "runs/bench-markers"
    ),
) -> None:
    """Marker poses over the two-view Cramer-Rao bound, planar flips and covariances, beside OpenCV's."""
    cv2.setNumThreads(1)
    require_same_options(folder, machine=text_mark(read_machine_text(machine)))
    if mode is Mode.EXACT:
        cells = _exact(machine, n or 200, seed, folder)
        console.print(exact_table(cells))
        lines = exact_lines(cells)
    else:
        cells = _rendered(machine, n or 20, seed, folder, SensorSettings(psf_px, noise_grey, jpeg))
        console.print(rendered_table(cells))
        lines = rendered_lines(cells)
    for line in lines:
        console.print(line)
    summary = folder / f"{mode.value}-seed{seed}.json"
    summary.write_text(json.dumps({"lines": lines, "cells": [asdict(one) for one in cells]}, indent=1), "utf-8")
    console.print(f"saved: {summary}")


def _exact(machine_name: str, n: int, seed: int, folder: Path) -> Sequence[CellResult]:
    camera = read_machine(machine_name).camera
    cells = []
    for cell in track(grid(), "cells", console=console):
        file = folder / f"exact-{cell.name}-n{n}-seed{seed}.json"
        cells.append(CellResult(**_saved(file, lambda cell=cell: asdict(run_cell(cell, camera, n, seed)))))
    return cells


def _rendered(machine_name: str, n: int, seed: int, folder: Path, settings: SensorSettings) -> Sequence[RenderedCell]:
    machine = read_machine(machine_name)
    studios: dict[float, Studio] = {}
    cells = []
    for cell in track([cell for cell in grid() if cell.sigma_px == grid()[0].sigma_px], "cells", console=console):
        file = folder / f"rendered-{settings_name(settings)}-{cell.name}-n{n}-seed{seed}.json"

        def work(cell: Cell = cell) -> dict[str, Any]:
            if cell.side_m not in studios:
                studios[cell.side_m] = Studio(machine, cell.side_m)
            return asdict(run_rendered_cell(cell, machine, studios[cell.side_m], n, seed, settings))

        cells.append(RenderedCell(**_saved(file, work)))
    return cells


def _saved(file: Path, work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """A cell's result from its file, or worked out and saved whole."""
    if not file.is_file():
        write_durably(file, json.dumps(work()))
    return json.loads(file.read_text(encoding="utf-8"))
