"""`longreach compare`: replay one recording with several machine files and plot the tool error of each over time."""

from html import escape
from itertools import cycle
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from diagnosis.compare import ToolMiss, tool_misses
from diagnosis.errors import DiagnosisError
from diagnosis.reading.together import read_together
from diagnosis.report.html import html_document, html_section, html_table
from diagnosis.report.svg import CurveLine, chart
from machine.errors import MachineError, MachineFileError
from recording.files import write_durably
from recording.machine_files import file_of_machine, text_of_machine

CURVE_CSS_CLASSES = ("before", "after", "measured", "floor")
BY = {"camera": "by the camera, all effects together", "encoders": "how the tool follows what was sent"}


def compare(
    recording: Annotated[Path, typer.Argument(help="an MCAP file or a folder of CSV files")],
    machine: Annotated[list[str], typer.Option("--machine", help="a machine file, or a shipped one by name; several")],
    html_file: Annotated[Path | None, typer.Option("--html", help="write the curves here")] = None,
) -> None:
    """Replay a recording against machine files: the tool error over time [mm] for each."""
    screen = Console(stderr=True)
    try:
        files = [file_of_machine(Path(given)) or Path(given) for given in machine]
        texts = [(path.name, text_of_machine(path)) for path in files]
        whole = read_together([recording], files[0])
        if not whole.has_judgeable_stage:
            raise DiagnosisError("; ".join(str(finding) for finding in whole.findings if finding.severity == "fatal"))
        found = tool_misses(whole, texts)
        if html_file is not None:
            write_durably(html_file, page(recording.name, found))
    except (DiagnosisError, MachineError, MachineFileError, OSError) as error:
        screen.print(f"[bold red]longreach:[/] {error}", soft_wrap=True)
        raise typer.Exit(2) from error
    Console().print(shown(found))


def shown(found: tuple[ToolMiss, ...]) -> Table:
    """Machine files by RMS and largest miss, each against the first."""
    out = Table(box=None, padding=(0, 2, 0, 0))
    for heading in ("machine file", "measured", "RMS mm", "95 % below mm", "of the first"):
        out.add_column(heading, justify="left" if heading in ("machine file", "measured") else "right")
    for by in BY:
        own = [curve for curve in found if curve.measured_by == by]
        for curve in own:
            share = curve.rms_mm / own[0].rms_mm
            out.add_row(
                curve.machine_file_name,
                BY[by],
                f"{curve.rms_mm:.2f}",
                f"{_miss_quantile_95(curve):.2f}",
                f"{100.0 * share:.0f} %",
            )
    return out


def page(name: str, found: tuple[ToolMiss, ...]) -> str:
    """The curves as a page without scripts."""
    parts = []
    for by, what in BY.items():
        own = [curve for curve in found if curve.measured_by == by]
        if not own:
            continue
        start_s = min(float(curve.t_s.min()) for curve in own)
        lines = [
            CurveLine(curve.machine_file_name, css, curve.t_s - start_s, curve.miss_mm)
            for curve, css in zip(own, cycle(CURVE_CSS_CLASSES), strict=False)
        ]
        rows = [(curve.machine_file_name, f"{curve.rms_mm:.2f}", f"{_miss_quantile_95(curve):.2f}") for curve in own]
        drawn = chart(lines, "time [s]", "tool error [mm]", f"Tool error, {what}")
        parts.append(
            html_section(f"Tool error, {what}", drawn + html_table(("machine file", "RMS mm", "95 % below"), rows))
        )
    return html_document(f"Compared: {name}", f"<h1>{escape(name)}</h1>" + "".join(parts))


def _miss_quantile_95(one: ToolMiss) -> float:
    return sorted(one.miss_mm.tolist())[int(0.95 * (len(one.miss_mm) - 1))]
