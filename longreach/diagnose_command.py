"""`longreach diagnose`: locate the sim-to-real gap, name the effects that cause it, and state how far it shrinks."""

import json
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from diagnosis.answer import answer_json
from diagnosis.budget import Budget, budget_of
from diagnosis.errors import DiagnosisError
from diagnosis.machine_out import MachineOutError, machine_text, require_room, write_machine
from diagnosis.reading.read import Read
from diagnosis.reading.together import read_together
from diagnosis.report.budget import budget_lines
from diagnosis.report.curves import CellCurves, curves_of
from diagnosis.report.page import report_page
from diagnosis.report.text import report_lines
from longreach.fit_baseline import BaselineError, make_baseline
from longreach.foreign_log import MappingFile, Urdf, Yes, as_recordings
from machine.effects.registry import NAMES
from recording.files import write_durably
from recording.machine_files import file_of_machine

# Progress of a diagnosis with the remaining time: a bar on a terminal, a line every few seconds elsewhere.

SPEED_PRIOR_WORK_S = 2.0  # of work that is taken to have gone as fast as usual before this computer's own speed counts
SOONER, LATER = 0.6, 2.0  # of what the speed so far predicts
ETA_MIN_PROGRESS_FRAC = 0.1  # of the work: before that the speed is a guess
PROGRESS_LINE_PERIOD_S = 2.0  # between two lines where there is no terminal
ETA_ROUNDING_STEPS_S = (5, 10, 15, 20, 30, 45, 60, 90, 120, 180, 240, 300, 420, 600, 900, 1200, 1800, 3600)


def left_s(done: float, total: float, elapsed_s: float) -> float:
    """Seconds that are left, by the speed so far; `done` and `total` in seconds of a usual computer."""
    return max(total - done, 0.0) * (elapsed_s + SPEED_PRIOR_WORK_S) / (max(done, 0.0) + SPEED_PRIOR_WORK_S)


def in_words(seconds: float) -> str:
    """Remaining time as a range: how many effects will be found, and so searched, is not known in advance."""
    low, high = (_nearest_step_s(factor * seconds) for factor in (SOONER, LATER))
    if high <= ETA_ROUNDING_STEPS_S[0]:
        return "a few seconds left"
    if high < 120:
        return f"{low} to {high} s left"
    return f"{low} s to {high // 60} min left" if low < 120 else f"{low // 60} to {high // 60} min left"


def _nearest_step_s(seconds: float) -> int:
    return min(ETA_ROUNDING_STEPS_S, key=lambda step: abs(step - seconds) / step)


Say = Callable[[str, float, float], None]  # words, share that is done, seconds since the begin


@dataclass(slots=True)
class Outlook:
    """Shows the progress of a diagnosis with the estimated remaining time."""

    show_progress: Say
    now_s: Callable[[], float] = time.monotonic
    _begun_s: float = field(init=False)
    _furthest: float = 0.0

    def __post_init__(self) -> None:
        self._begun_s = self.now_s()

    def on_progress(self, text: str, done: float, total: float) -> None:
        """Progress callback of the diagnosis. The share never decreases, although found effects slow the rest down."""
        elapsed_s = self.now_s() - self._begun_s
        share = self._furthest = min(max(self._furthest, done / max(total, 1e-9)), 0.99)
        rest = in_words(left_s(done, total, elapsed_s)) if share >= ETA_MIN_PROGRESS_FRAC else "remaining time unknown"
        self.show_progress(f"{text}: {100.0 * share:.0f} % done, {rest}", share, elapsed_s)

    def report_final_step(self, text: str) -> None:
        """What comes when all searches are done."""
        self.show_progress(f"{text}: {100.0 * self._furthest:.0f} % done", self._furthest, self.now_s() - self._begun_s)


@contextmanager
def console_progress(screen: Console, now_s: Callable[[], float] = time.monotonic) -> Iterator[Outlook]:
    """On this console."""
    if not screen.is_terminal:
        yield Outlook(_rate_limited_printer(screen), now_s)
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=screen, transient=True) as shown:
        task = shown.add_task("preparing", total=None)
        yield Outlook(lambda words, share, _s: shown.update(task, description=words, completed=share, total=1.0), now_s)


def _rate_limited_printer(screen: Console) -> Say:
    """For a log, or for the server that follows: at most one line in PROGRESS_LINE_PERIOD_S, and none at the start."""
    last_s = PROGRESS_LINE_PERIOD_S

    def say(words: str, _share: float, elapsed_s: float) -> None:
        nonlocal last_s
        if elapsed_s - last_s >= PROGRESS_LINE_PERIOD_S:
            last_s = elapsed_s
            screen.print(words, soft_wrap=True, highlight=False)

    return say


BAD_INPUT_EXIT_CODE = 2


def diagnose(
    recordings: Annotated[
        list[Path], typer.Argument(help="an MCAP file or a folder of CSV files; several of one machine count as one")
    ],
    machine_file: Annotated[
        Path | None,
        typer.Option("--machine", callback=file_of_machine, help="use this machine file, or a shipped one by name"),
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="write the full result here (JSON)")] = None,
    html_file: Annotated[Path | None, typer.Option("--html", help="write a report here")] = None,
    left_out: Annotated[
        list[str] | None,
        typer.Option("--without", help="leave this effect out of the catalogue, to test how the diagnosis rejects"),
    ] = None,
    fitting: Annotated[
        bool, typer.Option("--fit-baseline", help="make a machine file from baseline recordings instead")
    ] = False,
    machine_out: Annotated[
        Path | None, typer.Option("--machine-out", help="write the machine file with the diagnosed effects added")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="where --fit-baseline writes the machine file")] = None,
    urdf: Urdf = None,
    mapping: MappingFile = None,
    yes: Yes = False,
) -> None:
    """Diagnose the gap between a recording and its nominal machine. A ROS bag or a table is converted first."""
    screen = Console(stderr=True)
    for place in (json_file, html_file, machine_out, out):
        _within_reach(place, screen)  # before minutes of work, not after
    others = {"--json": json_file, "--html": html_file, "--without": left_out, "--machine-out": machine_out}
    _require_sense(fitting, out, [name for name, given in others.items() if given], screen)
    if fitting:
        _fit_baseline(recordings, machine_file, out, screen)
        return
    unknown = sorted(set(left_out or ()) - set(NAMES))
    if unknown:
        raise typer.BadParameter(f"--without {unknown[0]}: no such effect; see docs/effects.md")
    recordings = as_recordings(recordings, urdf, mapping, yes, screen)
    recording = recordings[0]
    try:
        whole = read_together(recordings, machine_file)
        if not whole.has_judgeable_stage:
            _set_aside((json_file, html_file, machine_out), screen)
        for finding in whole.findings:
            screen.print(f"[yellow]{finding.severity}[/] {escape(str(finding))}", soft_wrap=True)
        if not whole.has_judgeable_stage:
            raise typer.Exit(BAD_INPUT_EXIT_CODE)
        text = machine_text(recording, machine_file) if machine_out is not None else ""
        if machine_out is not None:
            require_room(text)
        found, result, curves = _run_diagnosis(whole, screen, tuple(left_out or ()))
    except (DiagnosisError, MachineOutError) as error:
        _set_aside((json_file, html_file, machine_out), screen)
        raise _bad_input_exit(error, screen) from error
    result["recordings"] = [path.name for path in recordings]
    for line in (*budget_lines(result), *report_lines(result)):
        typer.echo(line)
    _write(json_file, json.dumps(result, indent=1, allow_nan=False) + "\n", screen)
    _write(html_file, report_page(result, recording.name, curves), screen)
    if machine_out is not None:
        _machine_out(text, found, machine_out, screen)


def _require_sense(fitting: bool, out: Path | None, given: list[str], screen: Console) -> None:
    """Refuse a pair of options of which one would have no effect."""
    text = ""
    if fitting and given:
        text = f"{given[0]} has no effect with --fit-baseline, which only writes --out; leave one of them out"
    elif out is not None and not fitting:
        text = "--out is where --fit-baseline writes; give it as well, or --machine-out in place of --out"
    if text:
        raise _bad_input_exit(ValueError(text), screen)


def _set_aside(places: Sequence[Path | None], screen: Console) -> None:
    """Rename the files of an earlier run that this run does not write, so that they are not taken for its own."""
    for place in places:
        if place is None or not place.is_file():
            continue
        aside = place.with_name(f"{place.name}.earlier")
        try:
            place.replace(aside)
            text = f"{place} is not written; the one of an earlier run is {aside.name} now"
        except OSError as error:
            text = f"{place} is not written; the present file is of an earlier run ({error.strerror})"
        screen.print(f"[yellow]longreach:[/] {escape(text)}", soft_wrap=True)


def _bad_input_exit(error: Exception, screen: Console) -> typer.Exit:
    """Say why, and the exit that says that the input is to blame."""
    screen.print(f"[bold red]longreach:[/] {escape(str(error))}", soft_wrap=True)
    return typer.Exit(BAD_INPUT_EXIT_CODE)


def _machine_out(text: str, found: Budget, out: Path, screen: Console) -> None:
    """The machine file with the diagnosed effects added."""
    try:
        typer.echo(write_machine(text, found, out))
    except MachineOutError as error:
        _set_aside((out,), screen)
        raise _bad_input_exit(error, screen) from error


def _fit_baseline(recordings: list[Path], machine_file: Path | None, out: Path | None, screen: Console) -> None:
    if out is None:
        raise typer.BadParameter("--fit-baseline needs --out FILE, the machine file to write")
    try:
        typer.echo(make_baseline(recordings, machine_file, out, screen))
    except BaselineError as error:
        raise _bad_input_exit(error, screen) from error


def _run_diagnosis(
    whole: Read, screen: Console, left_out: tuple[str, ...]
) -> tuple[Budget, dict[str, Any], tuple[CellCurves, ...]]:
    with console_progress(screen) as shown:
        found = budget_of(whole, shown.on_progress, left_out)
        shown.report_final_step("next experiment")
        sliding = () if whole.nominal_machine is None else whole.nominal_machine.joint_slides
        return found, answer_json(found), curves_of(found.held_out, sliding)


def _within_reach(place: Path | None, screen: Console) -> None:
    """Refuse a file that could not be written in the end."""
    if place is None:
        return
    if place.is_dir():
        raise _bad_input_exit(OSError(f"{place} is a folder; name a file in it"), screen)
    if not place.absolute().parent.is_dir():
        raise _bad_input_exit(
            OSError(f"{place} cannot be written: folder {place.parent} does not exist; make it"), screen
        )


def _write(path: Path | None, text: str, screen: Console) -> None:
    if path is None:
        return
    try:
        write_durably(path, text)
    except OSError as error:
        screen.print(f"[bold red]longreach:[/] {escape(str(path))} cannot be written: {error.strerror}", soft_wrap=True)
        raise typer.Exit(BAD_INPUT_EXIT_CODE) from error
