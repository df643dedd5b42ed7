"""`longreach compile`: the numerics compiled once, at install or in an image, so that no start waits for a compiler.

Numba keeps compiled code by the content of each source file, its own version and the processor. It does not see that a
called function of another file has changed; the key here is over all of them, and another key empties the cache first.
"""

import hashlib
import json
import os
import platform
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated

import typer

from longreach.cli import COMPILED_CODE_MARK_FILE, NUMBA_CACHE_ENV_VARIABLE, cache_folder

_ROOT = Path(__file__).resolve().parent.parent
COMPILED_PACKAGES = ("machine", "server", "sim_plc", "diagnosis")  # those of the product that hold compiled code


def compile_numerics(
    machine: Annotated[str, typer.Option(help="machine file, or the name of a shipped one")] = "hiab033",
    again: Annotated[bool, typer.Option("--again", help="also if what is there is of this version")] = False,
    check: Annotated[bool, typer.Option("--check", help="only say whether it is; exit code 1 if not")] = False,
) -> None:
    """Compile the numerics once, so that no start waits for them."""
    from rich.console import Console

    console = Console(stderr=True, soft_wrap=True)
    if check or (is_compiled() and not again):
        console.print("the numerics are compiled" if is_compiled() else "the numerics are not compiled yet")
        raise typer.Exit(0 if is_compiled() else 1)
    console.print("compiling the numerics for this processor, once; one to three minutes on idle cores")
    started_s = time.monotonic()
    with console.status("clearing what is of another version") as status:

        def report(text: str) -> None:
            line = f"{text}; {time.monotonic() - started_s:.0f} s"
            status.update(line)
            if not console.is_terminal:  # a log file shows no status line
                console.print(line)

        _run_stages(machine, report)
    _mark_file().write_text(json.dumps({"key": source_key()}), encoding="utf-8")
    console.print(f"compiled in {time.monotonic() - started_s:.0f} s")


def is_compiled() -> bool:
    """Whether the compiled code in the cache is of these sources, these libraries and this processor."""
    try:
        found = json.loads(_mark_file().read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(found, dict) and found.get("key") == source_key()


def source_key() -> str:
    """Of all sources with compiled code, the compiler's version, and the processor it compiles for."""
    import llvmlite.binding as llvm  # that alone: numba itself takes a second to load

    name = os.environ.get("NUMBA_CPU_NAME") or f"{llvm.get_host_cpu_name()} {llvm.get_host_cpu_features().flatten()}"
    found = hashlib.sha256(f"{platform.python_version()} {version('numba')} {version('llvmlite')} {name}".encode())
    for path in kernel_files():
        found.update(path.read_bytes())
    return found.hexdigest()


def kernel_files() -> list[Path]:
    """Every source file of the product with a compiled function."""
    files = (file for package in COMPILED_PACKAGES for file in sorted((_ROOT / package).rglob("*.py")))
    return [file for file in files if b"from numba import" in file.read_bytes()]


def _mark_file() -> Path:
    return (cache_folder() or Path()) / COMPILED_CODE_MARK_FILE  # prepare() has seen to it that there is one


# The stages: what each of the system's processes compiles, in a process of its own, by what that process itself runs.


def clear(_machine: str) -> None:
    """Forget all compiled code of the product.

    Why by file names: an index holds the names of types, and one that names a type which is gone cannot be loaded.
    """
    stems = {file.stem for file in kernel_files()}
    given = os.environ.get(NUMBA_CACHE_ENV_VARIABLE)
    own = {file.parent / "__pycache__" for file in kernel_files()}
    folders = {Path(given)} if given else own | {folder for folder in (cache_folder(),) if folder is not None}
    for compiled in (file for folder in folders for file in folder.rglob("*.nb[ic]")):
        if compiled.name.split(".")[0] in stems:
            compiled.unlink(missing_ok=True)


def planning(machine: str) -> None:
    """Kinematics, planning and calibration: the server's main process."""
    from machine.chain import chain_of
    from server.settings import read_machine
    from server.warm_up import warm_up

    found = read_machine(machine)
    warm_up(found, chain_of(found))


def vision(machine: str) -> None:
    """Markers, odometry and picture health: the vision process."""
    from server.camera.contracts import VisionSettings
    from server.camera.process import build_pipeline
    from server.camera.sources.settings import HttpSource
    from server.settings import read_machine
    from server.vision.aruco_source import warm_up_boards

    build_pipeline(VisionSettings(HttpSource("http://127.0.0.1/")), read_machine(machine)).close()
    warm_up_boards()


def simulator(machine: str) -> None:
    """Plant, PLC and camera of the simulated machine."""
    from server.settings import read_machine_text
    from sim_plc.process import warm_up_all

    warm_up_all(read_machine_text(machine))


def diagnosis(machine: str) -> None:
    """Effects, their search and evidence: the process of a diagnosis."""
    from diagnosis.warm_up import warm_up
    from server.settings import read_machine

    warm_up(read_machine(machine))


@dataclass(frozen=True, slots=True)
class Stage:
    """What one process compiles; those of the same `parallel_group` run in parallel."""

    name: str
    parallel_group: int
    run: Callable[[str], None]


# First what the others call, so that no two compile the same.
COMPILE_STAGES = (
    Stage("clearing", 0, clear),
    Stage("kinematics and planning", 1, planning),
    Stage("vision", 2, vision),
    Stage("simulated machine", 2, simulator),
    Stage("diagnosis", 2, diagnosis),
)


def _run_stages(machine: str, report: Callable[[str], None]) -> None:
    done = 0
    with ProcessPoolExecutor(2, get_context("spawn"), max_tasks_per_child=1) as pool:
        for turn in sorted({stage.parallel_group for stage in COMPILE_STAGES}):
            waiting = {
                pool.submit(stage.run, machine): stage.name for stage in COMPILE_STAGES if stage.parallel_group == turn
            }
            report(f"{done} of {len(COMPILE_STAGES)} done, now: {', '.join(waiting.values())}")
            for future in as_completed(waiting):
                future.result()
                done += 1
                del waiting[future]
                if waiting:
                    report(f"{done} of {len(COMPILE_STAGES)} done, now: {', '.join(waiting.values())}")
