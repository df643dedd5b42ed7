"""`longreach`: one command, one subcommand per thing a person does."""

import logging
import sys
from pathlib import Path
from typing import Annotated, NoReturn

import typer
from rich.console import Console
from rich.markup import escape

from longreach import (
    calibration_command,
    camera_command,
    commission_command,
    demo,
    diagnose_command,
    diagnose_fleet_command,
    export_command,
    fleet_command,
    keys_command,
    position,
    record_command,
    relay_command,
    reproduce_command,
    sim_command,
    target_command,
)
from longreach.reference.command import docs
from machine.errors import MachineError
from server.access.keys import first_key as make_first_key
from server.access.roles import Role
from server.errors import ServerError
from server.settings import ServerSettings, read_settings
from server.version import __version__

app = typer.Typer(no_args_is_help=True, add_completion=False, help="Precise positioning of long-reach manipulators.")
app.command("sim")(sim_command.sim)
app.command("relay")(relay_command.relay)
app.command("export-plc")(export_command.export_plc)
app.command("commission")(commission_command.commission)
app.command("position")(position.position)
app.command("demo")(demo.demo)
app.command("diagnose")(diagnose_command.diagnose)
app.command("diagnose-fleet")(diagnose_fleet_command.diagnose_fleet)
app.command("reproduce")(reproduce_command.reproduce)
app.command("docs")(docs)
if sys.argv[1:2] not in (["serve"], ["sim"], ["demo"]):
    # These run beside a machine, and each of their child processes imports this file anew: the benches, which pull in
    # everything, took three quarters of their start.
    from longreach import bench

    app.add_typer(bench.app, name="bench", help="Measure; every figure in the README comes from here.")
app.add_typer(calibration_command.app, name="calibration", help="Show and export the local calibration.")
app.add_typer(camera_command.app, name="camera", help="Look at the stereo camera.")
app.add_typer(target_command.app, name="target", help="Print targets; measure how they sit.")
app.add_typer(fleet_command.app, name="fleet", help="Many machines from one program.")
app.add_typer(keys_command.app, name="keys", help="API keys: make, list, revoke.")
app.add_typer(record_command.app, name="recording", help="Check, convert and recover recordings.")

SettingsFile = Annotated[Path | None, typer.Option("--settings", help="TOML settings file; defaults when absent")]


@app.callback()
def setup(verbose: Annotated[bool, typer.Option("--verbose", help="log what happens")] = False) -> None:
    """Set up logging for every subcommand."""
    logging.basicConfig(
        level=logging.INFO if verbose else logging.WARNING, format="%(asctime)s %(levelname)s %(name)s: %(message)s"
    )


@app.command()
def serve(
    settings_file: SettingsFile = None,
    host: Annotated[str | None, typer.Option(help="address to listen on")] = None,
    port: Annotated[int | None, typer.Option(help="port to listen on")] = None,
    plc_host: Annotated[str | None, typer.Option(help="the PLC's address")] = None,
    plc_port: Annotated[int | None, typer.Option(help="the PLC's UDP port")] = None,
    plc_local_port: Annotated[int | None, typer.Option(help="our UDP port")] = None,
    camera_url: Annotated[str | None, typer.Option(help="multipart stream of side-by-side JPEG")] = None,
    runs: Annotated[str | None, typer.Option(help="folder for recordings")] = None,
    keys: Annotated[str | None, typer.Option(help="key file; required to listen beyond this computer")] = None,
    allow_host: Annotated[list[str] | None, typer.Option(help="a name it is reached by, beside addresses")] = None,
    first_key: Annotated[Path | None, typer.Option(help="make an operator's key here if there is none")] = None,
) -> None:
    """Start the server: panel, REST, link and vision processes."""
    from server.app import serve as run_server

    settings = _with_options(
        read_settings(settings_file),
        {
            "http": {"host": host, "port": port, "keys_file": keys, "allowed_hosts": allow_host or None},
            "plc": {"host": plc_host, "port": plc_port, "local_port": plc_local_port},
            "camera": {"kind": "http", "url": camera_url} if camera_url else {},
            "recording": {"folder": runs},
        },
    )
    keys_file = settings.http.keys_file
    if first_key and keys_file and make_first_key(Path(keys_file), Role.OPERATOR, first_key):
        Console(stderr=True).print(f"a first key was made: it is in {first_key}")
    Console(stderr=True).print(f"longreach {__version__}: panel at http://{settings.http.host}:{settings.http.port}/")
    run_server(settings)


def _with_options(settings: ServerSettings, options: dict[str, dict[str, object]]) -> ServerSettings:
    data = settings.model_dump()
    for section, values in options.items():
        given = {name: value for name, value in values.items() if value is not None}
        data[section] = given if "kind" in given else {**data[section], **given}
    return ServerSettings.model_validate(data)


def main() -> None:
    """Entry point: expected errors become one clear line and exit code 2."""
    try:
        app()
    except (ServerError, MachineError) as error:
        _complain(error)


def _complain(error: Exception) -> NoReturn:
    """One line that says what is wrong and what to do, and exit code 2."""
    Console(stderr=True).print(f"[bold red]longreach:[/] {escape(str(error))}")
    raise SystemExit(2) from error


if __name__ == "__main__":
    main()
