"""`longreach`: one command with a subcommand per task; each subcommand's imports are loaded on call."""

import contextlib
import logging
import os
import stat
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, NoReturn

import typer

import machine
from longreach.lazy_commands import Lazy, LazyGroup
from longreach.signals import end_as_by_ctrl_c, exit_code
from machine.errors import MachineError
from server.errors import ServerError

# fmt: off
CLI_COMMANDS = (
    Lazy("serve", "longreach.serve_command:serve", "Start the server: panel, REST, link and vision processes."),
    Lazy("sim", "longreach.sim_command:sim", "Start the simulated machine in real time, until Ctrl-C."),
    Lazy("relay", "longreach.relay_command:relay",
        "Pass datagrams between PC and PLC, and drop, duplicate, delay or corrupt some; Ctrl-C prints the counts."),
    Lazy("export-plc", "longreach.export_command:export_plc",
        "Write the TwinCAT program, EAP sheet, Wireshark dissector, C header, golden vectors and guides."),
    Lazy("commission", "longreach.commission_command:commission",
        "Go through the check list of a new machine. Exit code 0: all checks passed, 1: a check failed, 3: a check "
            "was inconclusive."),
    Lazy("position", "longreach.position:position",
        "Position the tool on its target: look, orient, calibrate, then look and move until inside tolerance."),
    Lazy("identify", "longreach.identify_command:identify",
        "Identify this machine: one test drive, its error budget, and the effects to use."),
    Lazy("compare", "longreach.compare_command:compare",
        "Replay a recording against machine files: the tool error over time [mm] for each."),
    Lazy("hand-eye", "longreach.hand_eye_command:hand_eye",
        "Hand-eye calibration from poses of hand and target. Exit code 0: found, 1: not found; the reason is printed."),
    Lazy("compile", "longreach.compile_command:compile_numerics",
        "Compile the numerics once, so that no start waits for them."),
    Lazy("demo", "longreach.demo:demo", "Start everything on this computer and show where the panel is."),
    Lazy("diagnose", "longreach.diagnose_command:diagnose",
        "Diagnose the gap between a recording and its nominal machine. A ROS bag or a table is converted first."),
    Lazy("diagnose-fleet", "longreach.diagnose_fleet_command:diagnose_fleet",
        "Diagnose every recording below a folder, and write what the machines share and how it drifts."),
    Lazy("reproduce", "benchmarks.reproduce.command:reproduce",
        "Tables 2, 3, 4 and Figures 5 to 9: fast over n machines, rendered over a few. Resumes where it was stopped."),
    Lazy("bench", "benchmarks.cli:app", "Measure; every figure in the README comes from here."),
    Lazy("machine", "longreach.machine_command:app", "A new machine file; a machine as URDF."),
    Lazy("settings", "longreach.settings_command:app", "A new settings file."),
    Lazy("calibration", "longreach.calibration_command:app", "Show and export the local calibration."),
    Lazy("camera", "longreach.camera_command:app", "Check the stereo camera; calibrate its lens."),
    Lazy("target", "longreach.target_command:app", "Print targets; measure how they sit."),
    Lazy("fleet", "longreach.fleet_command:app", "Many machines from one program."),
    Lazy("keys", "longreach.keys_command:app", "API keys: make, list, revoke."),
    Lazy("recording", "longreach.record_command:app", "Check, convert and recover recordings."),
)
# fmt: on


# What a command's process, and all that it starts, need of their surroundings: set before anything else.

LOOPBACK_HOSTS = ("127.0.0.1", "localhost", "::1")
NUMBA_CACHE_ENV_VARIABLE = "NUMBA_CACHE_DIR"
# Which sources, libraries and processor the compiled code in that folder is of
COMPILED_CODE_MARK_FILE = "longreach-compiled.json"


def prepare() -> None:
    """No import from the working folder, no proxy in front of this computer itself, a place for compiled code."""
    os.environ["PYTHONSAFEPATH"] = "1"  # read by every Python that is started from here
    for name in ("no_proxy", "NO_PROXY"):  # urllib reads the first of them that is there
        given = os.environ.get(name, "")
        os.environ[name] = ",".join(dict.fromkeys([*filter(None, given.split(",")), *LOOPBACK_HOSTS]))
    prepare_cache()


def prepare_cache() -> None:
    """A place for compiled code, before anything compiles; a program that uses the Python API needs no more."""
    given = os.environ.get(NUMBA_CACHE_ENV_VARIABLE, "")
    if given and os.path.isfile(os.path.join(given, COMPILED_CODE_MARK_FILE)) and not _is_folder_writable(Path(given)):
        os.environ[NUMBA_CACHE_ENV_VARIABLE] = str(_link_compiled_code(Path(given), _temporary_cache()))
    elif cache_folder() is None:
        os.environ[NUMBA_CACHE_ENV_VARIABLE] = str(_temporary_cache())
        sys.stderr.write(
            f"longreach: compiled code is kept in {os.environ[NUMBA_CACHE_ENV_VARIABLE]}, because neither the "
            "program's folder nor a "
            f"cache of this user can be written; {NUMBA_CACHE_ENV_VARIABLE} names a lasting folder\n"
        )
    if (numba := sys.modules.get("numba")) is not None and os.environ.get(
        NUMBA_CACHE_ENV_VARIABLE
    ):  # it read its settings before us
        numba.config.CACHE_DIR = os.environ[NUMBA_CACHE_ENV_VARIABLE]


def _cache_folders() -> Iterator[Path]:
    """Where numba keeps compiled code, in its order."""
    if given := os.environ.get(NUMBA_CACHE_ENV_VARIABLE):
        yield Path(given)
    yield Path(machine.__file__).parent / "__pycache__"
    user = "~/Library/Caches" if sys.platform == "darwin" else os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    yield Path(os.path.expanduser(user)) / "numba"


def cache_folder() -> Path | None:
    """Where compiled code is kept: numba's first folder that can be written."""
    return next((folder for folder in _cache_folders() if _is_folder_writable(folder)), None)


def _is_folder_writable(folder: Path) -> bool:
    if not folder.is_absolute():  # a home that is not known
        return False
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _link_compiled_code(compiled: Path, folder: Path) -> Path:
    """A folder with links to all compiled code of one that can only be read (an image's): numba requires one that can
    be written, and replaces a link by what it compiles itself.
    """
    for file in compiled.rglob("*"):
        link = folder / file.relative_to(compiled)
        if not file.is_dir() and not link.exists():
            link.parent.mkdir(parents=True, exist_ok=True)
            with contextlib.suppress(FileExistsError):  # another process of this user was first
                link.symlink_to(file)
    return folder


def _temporary_cache() -> Path:
    """The same for every start of this user, of no other one: what is in it is run."""
    if not hasattr(os, "getuid"):  # Windows: the folder for temporary files is the user's own
        return Path(tempfile.gettempdir()) / "longreach-numba"
    folder = Path(tempfile.gettempdir()) / f"longreach-numba-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    ours = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o077
    return folder if ours else Path(tempfile.mkdtemp(prefix="longreach-numba-"))


class Commands(LazyGroup):
    """Of `longreach`."""

    lazy_commands = CLI_COMMANDS


app = typer.Typer(cls=Commands, no_args_is_help=True, help="Precise positioning of long-reach manipulators.")


def _print_version(wanted: bool) -> None:
    if wanted:
        from server.version import __version__

        typer.echo(f"longreach {__version__}")
        raise typer.Exit


@app.callback()
def setup(
    verbose: Annotated[bool, typer.Option("--verbose", help="log what happens")] = False,
    version: Annotated[
        bool, typer.Option("--version", help="print the version", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    """Set up logging for every subcommand."""
    logging.basicConfig(
        level=logging.INFO if verbose else logging.WARNING, format="%(asctime)s %(levelname)s %(name)s: %(message)s"
    )


def main(command: typer.Typer = app) -> None:
    """Entry point: expected errors become one clear line and exit code 2; SIGTERM and SIGHUP end all as Ctrl-C does."""
    prepare()
    end_as_by_ctrl_c()
    try:
        command()
    except (ServerError, MachineError) as error:
        _exit_with_error(error)
    except SystemExit as ending:
        code = exit_code(ending.code)
        if (warm_up := sys.modules.get("server.warm_up")) is not None:  # a command that ran link and vision
            warm_up.exit_process(code)
        raise SystemExit(code) from None


def _exit_with_error(error: Exception) -> NoReturn:
    """One line that says what is wrong and what to do, and exit code 2."""
    from rich.console import Console  # here: most calls complain of nothing
    from rich.markup import escape

    Console(stderr=True).print(f"[bold red]longreach:[/] {escape(str(error))}", soft_wrap=True)
    raise SystemExit(2) from error


if __name__ == "__main__":
    main()
