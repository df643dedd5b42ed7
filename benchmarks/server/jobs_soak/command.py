"""`longreach bench jobs-soak`: very many jobs in a row with faults injected, over real processes; each one saved."""

import json
import time
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import httpx
import typer
from rich.console import Console

from benchmarks.kills.drill import fast_machine
from benchmarks.same_options import require_same_options
from benchmarks.saved_lines import add_line, every_line, open_to_add
from benchmarks.server.jobs_soak.case import SoakCase, run_all, run_case
from benchmarks.server.jobs_soak.faults import planned
from benchmarks.server.jobs_soak.figures import SoakKind, figures_of, line, summary
from benchmarks.server.jobs_soak.stand import OWNER, Stand
from longreach.fleet_client import JobClient, JobRefusedError

FOLDER = Path("runs/bench-jobs-soak")
START_S = 240.0  # the first start on a machine compiles
RUNS_KEPT, BEGIN_TRIES = 5, 4
SPAN_FULL_S, SPAN_QUICK_S = 45.0, 5.0  # within which a fault falls: about as long as the jobs take


def jobs_soak(
    n: Annotated[int, typer.Option(min=1, help="jobs in all")] = 200,
    seed: Annotated[int, typer.Option(min=0, help="of the machine and of the faults")] = 1,
    quick: Annotated[
        bool, typer.Option("--quick", help="a look and a short move instead of a whole positioning job")
    ] = False,
    fast: Annotated[bool, typer.Option("--fast", help="whole positioning jobs, the TCP at 0.15 m/s")] = False,
    preset: Annotated[str, typer.Option(help="ideal, realistic or paper")] = "realistic",
    folder: Annotated[Path, typer.Option(help="where every job is saved; a second run resumes")] = FOLDER,
) -> None:
    """Memory, handles, tasks and database over many jobs with faults; that the server always finds back."""
    console = Console(width=200)
    kind: SoakKind = "quick" if quick else "fast" if fast else "full"
    require_same_options(folder / kind, preset=preset)
    cases = bench(n, seed, kind, preset, folder / kind, console)
    if not cases:
        raise typer.Exit(1)
    figures = figures_of(cases)
    (folder / kind / f"result-{seed}.json").write_text(json.dumps(asdict(figures), indent=1))
    console.print(summary(figures, kind), highlight=False)
    if len(cases) < n or not figures.holds:
        raise typer.Exit(1)


def bench(n: int, seed: int, kind: SoakKind, preset: str, folder: Path, console: Console) -> list[SoakCase]:
    """Run or resume until n cases are there; Ctrl-C or a server that is lost ends it early."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{seed}-cases.jsonl"
    cases = every_line(path, lambda text: SoakCase(**json.loads(text)))
    if len(cases) >= n:
        return cases[:n]
    try:
        machine_file = None if kind == "full" else fast_machine(folder)[0]  # TCP at 0.15 m/s
        quick = kind == "quick"
        with Stand(preset, seed, folder, machine_file) as stand, open_to_add(path) as file:
            _begin(stand, quick)
            segment, t0_s = (cases[-1].segment + 1 if cases else 1), time.monotonic()
            for number in range(len(cases) + 1, n + 1):
                fault = planned(seed, number, SPAN_QUICK_S if quick else SPAN_FULL_S)
                case = run_case(number, segment, stand, fault, quick, t0_s)
                add_line(file, asdict(case))
                cases.append(case)
                console.print(line(case), highlight=False)
                _thin_out(folder / "runs")
    except KeyboardInterrupt:
        console.print("ended early; the next run goes on from here")
    except (httpx.HTTPError, JobRefusedError) as error:
        console.print(f"[red]the server was lost after {len(cases)} jobs:[/] {error}; its log is in {folder}/logs")
    return cases


def _begin(stand: Stand, quick: bool) -> None:
    """Wait until it is ready; a quick run orients once, which is where its moves return to.

    Raises: JobRefusedError: it is not ready in time, or does not find its target.
    """
    with JobClient(stand.url, owner=OWNER) as client:
        client.wait_ready(START_S)
        told = ""
        for _ in range(BEGIN_TRIES if quick else 0):
            end = run_all(client, ({"kind": "look"}, {"kind": "orient"}))[-1]
            if end.state == "done":
                return
            told = f"{end.state}, {end.reason}"
        if quick:
            raise JobRefusedError(f"at the beginning: {told}")


def _thin_out(runs: Path) -> None:
    """Delete all recordings but the last: with pictures, one of a positioning job has 90 MB."""
    for old in sorted(runs.glob("*.mcap"))[:-RUNS_KEPT]:
        old.unlink()
