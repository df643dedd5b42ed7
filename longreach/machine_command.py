"""`longreach machine ...`: a new machine file, and a machine as URDF."""

from pathlib import Path
from typing import Annotated, NoReturn

import numpy as np
import typer
from rich.console import Console
from rich.markup import escape

from diagnosis.errors import DiagnosisError
from diagnosis.log.nominal import Nominal, nominal_of
from diagnosis.log.urdf_files import UrdfFiles
from machine.description import parse_machine_toml
from machine.effects.urdf_xml import urdf_chain
from machine.errors import MachineError, MachineFileError
from machine.urdf_out import JointLimits, arm_urdf, edited_urdf, machine_urdf, split_entries
from recording.files import write_durably
from recording.machine_files import file_of_machine, text_of_machine

app = typer.Typer(no_args_is_help=True)
MachineFile = Annotated[
    Path, typer.Option("--machine", callback=file_of_machine, help="a machine file, or the name of a shipped one")
]
DEFAULT_MACHINE = Path("hiab033")


@app.command()
def urdf(
    machine: MachineFile = DEFAULT_MACHINE,
    nominal: Annotated[bool, typer.Option("--nominal", help="leave the file's [[effect]]s out")] = False,
    out: Annotated[Path | None, typer.Option("--out", help="file to write; standard output when absent")] = None,
) -> None:
    """Write the machine as URDF, with zeros, lengths, tilts and mount of its effects applied."""
    screen = Console(stderr=True)
    try:
        text, left_out = urdf_of(machine, nominal)
    except (MachineError, DiagnosisError) as error:
        _exit_with_error(str(error))
    for line in left_out:
        screen.print(f"[yellow]not in the URDF:[/] {escape(line)}", soft_wrap=True)
    _write(out, text + "\n")


@app.command()
def new(
    file: Annotated[Path, typer.Argument(help="the machine file to write")] = Path("machine.toml"),
    machine: MachineFile = DEFAULT_MACHINE,
) -> None:
    """Write a machine file to start from: the shipped one, with its comments."""
    try:
        text = text_of_machine(machine)
    except MachineFileError as error:
        _exit_with_error(str(error))
    write_new(file, text)


def write_new(file: Path, text: str) -> None:
    """Write a template, never over a file. Raises: typer.Exit 2."""
    if file.exists():
        _exit_with_error(f"{file} exists already; choose another name")
    _write(file, text)
    typer.echo(f"written: {file}")


def urdf_of(machine: Path, nominal: bool) -> tuple[str, tuple[str, ...]]:
    """A machine file's URDF, and what of its effects a URDF cannot hold.

    Raises: MachineError, DiagnosisError: the file cannot be read, is wrong, or has no geometry.
    """
    text = text_of_machine(machine)
    known = nominal_of(text, UrdfFiles(machine_file_folder=machine.parent))
    held, left_out = ((), ()) if nominal else split_entries(known.baseline_effects)
    if known.arm is None:
        raise MachineFileError(f"{machine} has no geometry: {known.why_absent('structure')}")
    try:
        strict = parse_machine_toml(text)
    except MachineFileError:
        strict = None
    if strict is not None:
        return machine_urdf(strict, held), left_out
    own = _own_urdf(text, machine)
    if own is not None:
        return edited_urdf(*own, known.joint_names, held, known.T_tcp_cam_left), left_out
    return arm_urdf(
        known.name, known.joint_names, known.arm, held, _joint_limits(known), known.T_tcp_cam_left
    ), left_out


def _own_urdf(text: str, machine: Path) -> tuple[str, str, str] | None:
    """The URDF that a machine file names, its base and its tip."""
    import tomllib

    section = tomllib.loads(text.removeprefix("\ufeff")).get("urdf")
    if not isinstance(section, dict):
        return None
    found = UrdfFiles(machine_file_folder=machine.parent).urdf_text(section["file"])
    if found is None:
        raise MachineFileError(f"{section['file']} is not next to {machine}; put it there")
    urdf_chain(found, section["base_link"], section["tip_link"])
    return found, section["base_link"], section["tip_link"]


def _joint_limits(known: Nominal) -> JointLimits:
    speed = np.full(known.n, np.inf) if known.actuators is None else known.actuators.joints[:, 0]
    return JointLimits(known.q_min, known.q_max, speed)


def _write(out: Path | None, text: str) -> None:
    if out is None:
        print(text, end="")
        return
    try:
        write_durably(out, text)
    except OSError as error:
        _exit_with_error(f"{out} cannot be written: {error.strerror}")


def _exit_with_error(text: str) -> NoReturn:
    Console(stderr=True).print(f"[bold red]longreach:[/] {escape(text)}", soft_wrap=True)
    raise typer.Exit(2)
