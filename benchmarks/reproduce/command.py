"""`longreach reproduce`: the paper's tables and figures beside ours, and the noise of the fast world."""

from enum import StrEnum
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from server.errors import SettingsError
from server.settings import read_machine

NOISE_WORLDS = 24
NO_MATPLOTLIB = "pictures need matplotlib, which comes with the bench extra: pip install 'longreach[bench]'"


class What(StrEnum):
    """What to reproduce."""

    TABLE2 = "table2"
    TABLE3 = "table3"
    TABLE4 = "table4"
    FIGURES = "figures"
    ALL = "all"
    NOISE = "noise"
    REPORT = "report"


def reproduce(
    what: Annotated[
        What, typer.Argument(help="table3 and table4 are the same runs; report: from what is saved")
    ] = What.ALL,
    n: Annotated[int | None, typer.Option(min=1, help="machines, fast [1000]; worlds to render for noise [24]")] = None,
    rendered: Annotated[int, typer.Option(min=0, help="machines end to end: images, UDP, server; 2 minutes each")] = 10,
    seed: Annotated[int, typer.Option(min=1, help="first machine")] = 1,
    out: Annotated[Path, typer.Option(help="folder for cases, pictures and report.html")] = Path("runs/reproduce"),
    ship: Annotated[bool, typer.Option("--ship", help="noise: put the fit into the package")] = False,
) -> None:
    """Tables 2, 3, 4 and Figures 5 to 9: fast over n machines, rendered over a few. Resumes where it was stopped."""
    from benchmarks.reproduce.rendered_paths import one_thread

    one_thread()
    console = Console()
    if find_spec("matplotlib") is None:
        console.print(
            f"[yellow]{escape(NO_MATPLOTLIB)}; cases are saved, `longreach reproduce report` draws them later[/]"
        )
    if what is What.NOISE:
        _noise(n or NOISE_WORLDS, out / "noise", ship, console)
    else:
        _run_tables(what, range(seed, seed + (n or 1000)), range(seed, seed + rendered), out, console)
    _report(out, seed, console)


def _run_tables(what: What, seeds: range, rendered: range, out: Path, console: Console) -> None:
    from benchmarks.reproduce.fast_tables import table_2, table_4
    from benchmarks.reproduce.noise_model import fitted_noise
    from benchmarks.reproduce.rendered_tables import TABLE_2_KINDS, TABLE_4_KINDS, rendered_tables

    machine, noise, kinds = read_machine("hiab033"), fitted_noise(), ()
    if what in (What.TABLE3, What.TABLE4, What.ALL):
        table_4(machine, noise, seeds, out / "fast", console)
        kinds += TABLE_4_KINDS
    if what in (What.TABLE2, What.ALL):
        table_2(machine, noise, seeds, out / "fast", console)
        kinds += TABLE_2_KINDS
    if kinds and rendered:
        rendered_tables(machine, kinds, rendered, out / "rendered", console)


def _noise(n: int, folder: Path, ship: bool, console: Console) -> None:
    from benchmarks.reproduce.noise_command import run_noise
    from benchmarks.reproduce.noise_model import ship_fitted

    model, _ = run_noise(n, n, folder, console)
    console.print(f"fitted: {folder / 'noise_fitted.json'}")
    if ship:
        console.print(f"shipped as {ship_fitted(model)}")


def _report(out: Path, seed: int, console: Console) -> None:
    from benchmarks.reproduce.compose import printed_tables, write_report
    from benchmarks.reproduce.noise_model import fitted_noise

    for view in printed_tables(out):
        table = Table(*view.headings, title=view.title, title_justify="left")
        for row in view.rows:
            table.add_row(*row)
        console.print(table)
    try:
        console.print(f"report: {write_report(out, read_machine('hiab033'), fitted_noise(), seed)}")
    except ImportError as error:
        raise SettingsError(NO_MATPLOTLIB) from error
