"""`longreach demo`: simulated machine and server as separate processes, and the panel's address."""

import os
import shutil
import sys
import time
import webbrowser
from collections.abc import Mapping
from pathlib import Path
from subprocess import Popen
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.status import Status

from longreach.compile_command import is_compiled
from longreach.fleet_client import JobClient, JobRefusedError
from longreach.processes import Address, Stack, StackPorts, require_bindable
from server.errors import SettingsError

_SERVER = "server does not answer"
_PARTS = {  # what /readyz says while it is missing -> when it is there
    "numerics": "the numerics are loaded",
    "camera": "pictures arrive",
}
# A busy computer of two cores takes minutes to compile; a process that ends is reported immediately
STARTUP_TIMEOUT_S = 1800.0


def demo(
    preset: Annotated[str, typer.Option(help="ideal, realistic or paper")] = "realistic",
    seed: Annotated[int, typer.Option(help="seed of the simulated machine")] = 1,
    port: Annotated[int, typer.Option(help="port of the panel")] = 8080,
    browser: Annotated[bool, typer.Option(help="open the panel in a browser if there is one")] = True,
    seconds: Annotated[float, typer.Option(help="end after this time; 0 = on Ctrl-C")] = 0.0,
) -> None:
    """Start everything on this computer and show where the panel is."""
    from sim_plc.presets import PresetError, checked_preset  # here: who only asks for help draws no machine

    console = Console()
    try:
        checked_preset(preset)
        option = f"{_longreach_command()} demo --port {port + 1 if port < 65535 else port - 1}"
        require_bindable((Address("127.0.0.1", port, option, option),))
    except (PresetError, SettingsError) as error:
        console.print(f"[bold red]not started:[/] {escape(str(error))}", soft_wrap=True)
        raise typer.Exit(2) from error
    ports = StackPorts.free()
    ports = StackPorts(http=port, plc=ports.plc, plc_local=ports.plc_local, camera=ports.camera)
    started = time.monotonic()
    runs = Path("runs") / f"{preset}-{seed}"  # what was calibrated on one machine says nothing of another
    logs = runs / "logs"
    console.print("starting simulator, server and camera")
    if not is_compiled():
        console.print(
            f"the numerics are not compiled yet: one to three minutes, once; `{_longreach_command()} compile` does it"
        )
    with Stack(ports, preset=preset, seed=seed, log_folder=logs, runs_folder=runs) as stack:
        try:
            with console.status("starting") as status, JobClient(stack.url) as client:
                stages = Stages(console, stack.url)
                client.wait_ready(
                    STARTUP_TIMEOUT_S,
                    lambda waited_s, why: _show_startup_status(
                        stack.processes, status, waited_s, stages.report_progress(waited_s, why)
                    ),
                )
        except JobRefusedError as error:
            console.print(f"[bold red]not started:[/] {error}; see {logs}")
            raise typer.Exit(1) from error
        took_s = time.monotonic() - started
        console.print(f"[bold green]ready[/] after {took_s:.0f} s: open [bold]{stack.url}/[/]   (Ctrl-C ends it)")
        console.print(f"or unattended:  {_longreach_command()} position --url {stack.url}")
        console.print(f"recordings and calibration of this machine: {runs}/")
        if browser:
            webbrowser.open(stack.url)
        _wait(stack, seconds, logs)


class Stages:
    """A line for each stage of the start, once, as it ends: the panel answers, then what was still missing is there."""

    def __init__(self, console: Console, url: str) -> None:
        self._console, self._ended, self._stages = (
            console,
            set[str](),
            {_SERVER: f"the panel answers: {url}/", **_PARTS},
        )

    def report_progress(self, waited_s: float, why: str) -> str:
        """The reason itself, after a line for all that has ended since the last one."""
        for missing, there in self._stages.items():
            if missing not in why and not why.startswith(_SERVER) and missing not in self._ended:
                self._ended.add(missing)
                self._console.print(f"{waited_s:4.0f} s  {there}")
        return why


def _show_startup_status(processes: Mapping[str, Popen[bytes]], status: Status, waited_s: float, why: str) -> None:
    """How far it is; what has ended will never be ready."""
    if ended := _ended_process_text(processes):
        raise JobRefusedError(ended)
    status.update(f"starting, {waited_s:.0f} s: {escape(_while_starting(why))}")


def _while_starting(why: str) -> str:
    """What a server waits for means something else while everything only starts: no cable is loose here."""
    if why.startswith(_SERVER):
        return "the server is not up yet"
    return "no image from the simulated camera yet" if "the camera" in why else why


def _ended_process_text(processes: Mapping[str, Popen[bytes]]) -> str:
    """What has ended, and how; empty while all run."""
    ended = (
        f"{name} ended with code {process.returncode}"
        for name, process in processes.items()
        if process.poll() is not None
    )
    return next(ended, "")


def _longreach_command() -> str:
    """How the one who started this calls longreach from here."""
    if shutil.which("longreach"):
        return "longreach"
    by_module = Path(sys.argv[0]).name == "__main__.py"  # as `python -m longreach`
    return f"{os.path.relpath(sys.executable)} -m longreach" if by_module else os.path.relpath(sys.argv[0])


def _wait(stack: Stack, seconds: float, logs: Path) -> None:
    deadline = time.monotonic() + seconds if seconds > 0.0 else float("inf")
    try:
        while time.monotonic() < deadline:
            if ended := _ended_process_text(stack.processes):
                Console(stderr=True).print(f"{ended}; see {logs}")
                raise typer.Exit(1)
            time.sleep(0.3)
    except KeyboardInterrupt:
        return
