"""`longreach diagnose-fleet`: many recordings over processes of this computer, or over a Dask cluster."""

import hashlib
import json
import os
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated, cast

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from diagnosis.fleet.page import fleet_page
from diagnosis.fleet.run import diagnose_all, recordings_below
from diagnosis.fleet.summary import summary_of
from machine.errors import MachineFileError
from recording.files import write_durably
from recording.machine_files import file_of_machine, text_of_machine
from recording.spawn import SINGLE_THREAD_ENVIRONMENT
from server.version import __version__

# Fingerprint of the code that produced stored results, so that results of two versions are never mixed.

SOURCE_FILE_SUFFIXES = (".py", ".json")


def code_mark(root: Path, sources: tuple[str, ...]) -> str:
    """Fingerprint of the code below these folders of `root`."""
    digest = hashlib.sha256()
    files = (file for folder in sources for file in (root / folder).rglob("*") if file.suffix in SOURCE_FILE_SUFFIXES)
    for file in sorted(files):
        digest.update(str(file.relative_to(root)).encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


BAD_INPUT_EXIT_CODE = 2
REPOSITORY_ROOT = Path(__file__).parents[1]
DIAGNOSIS_CODE_PACKAGES = (
    "diagnosis",
    "machine",
    "recording",
)  # code that answers depend on: saved ones are of this code, or none


def diagnose_fleet(
    folder: Annotated[Path, typer.Argument(help="recordings below it: MCAP files and folders with run.toml")],
    out: Annotated[Path, typer.Option(help="answers and report go here; a second run resumes")] = Path("runs/fleet"),
    machine_file: Annotated[
        Path | None,
        typer.Option("--machine", callback=file_of_machine, help="use this machine file, or the shipped one, for all"),
    ] = None,
    workers: Annotated[int, typer.Option(min=1, help="processes on this computer")] = os.cpu_count() or 1,
    dask: Annotated[str, typer.Option(help="a Dask scheduler instead, such as tcp://host:8786")] = "",
) -> None:
    """Diagnose every recording below a folder, and write what the machines share and how it drifts."""
    screen = Console(stderr=True)
    if machine_file is not None:
        try:
            text_of_machine(machine_file)
        except MachineFileError as error:
            raise _bad_input_exit(str(error), screen) from error
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _bad_input_exit(f"--out {out}: {error.strerror}; name a folder", screen) from error
    paths = recordings_below(folder)
    if not paths:
        raise _bad_input_exit(f"{folder}: no recording below it (MCAP files, folders with run.toml)", screen)
    columns = (TextColumn("diagnosing"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with _executor_factory(workers, dask) as executor, Progress(*columns, console=screen, transient=True) as shown:
        task = shown.add_task("", total=len(paths))
        results = diagnose_all(
            paths,
            out / "answers",
            executor(),
            f"{__version__} {code_mark(REPOSITORY_ROOT, DIAGNOSIS_CODE_PACKAGES)}",
            machine_file,
            lambda _name, done, _total: shown.update(task, completed=done),
            renewed=executor,
            base=folder,
        )
    fleet = summary_of(results)
    write_durably(out / "fleet.json", json.dumps(results, indent=1) + "\n")
    write_durably(out / "fleet.html", fleet_page(fleet, folder.name))
    for effect in fleet.shared_effects:
        joint = "" if effect.joint is None else f" on joint {effect.joint}"
        typer.echo(f"{effect.name}{joint}: {len(effect.machines_with)} of {len(fleet.machines)} machines")
    for drift in fleet.effect_drifts:
        if drift.is_drifting:
            typer.echo(f"{drift.machine}: {drift.name} drifts by {drift.per_day:.3g} {drift.unit} a day")
    typer.echo(f"{len(paths)} recordings, {len(fleet.unusable_recordings)} not usable; report: {out / 'fleet.html'}")


def _bad_input_exit(text: str, screen: Console) -> typer.Exit:
    screen.print(f"[bold red]longreach:[/] {escape(text)}", soft_wrap=True)
    return typer.Exit(BAD_INPUT_EXIT_CODE)


@contextmanager
def _executor_factory(workers: int, dask: str) -> Iterator[Callable[[], Executor]]:
    """A new pool of processes at each call by default; Dask's client gives an executor of the same kind."""
    os.environ.update({**SINGLE_THREAD_ENVIRONMENT, **os.environ})
    if not dask:
        with ExitStack() as pools:
            yield lambda: pools.enter_context(ProcessPoolExecutor(workers, mp_context=get_context("spawn")))
        return
    try:
        from dask.distributed import Client  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise typer.BadParameter(
            "Dask is not installed: pip install 'longreach[fleet]'", param_hint="--dask"
        ) from error
    try:
        client = Client(dask)
    except (OSError, ValueError) as error:
        raise typer.BadParameter(f"no Dask scheduler at {dask}: {error}", param_hint="--dask") from error
    with client:
        yield lambda: cast(Executor, client.get_executor(pure=False))
