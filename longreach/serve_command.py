"""`longreach serve`: start the server with a settings file and command-line overrides."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from longreach.processes import Address
    from server.settings import ServerSettings

SettingsFile = Annotated[Path | None, typer.Option("--settings", help="TOML settings file; defaults when absent")]


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
    allow_host: Annotated[
        list[str] | None, typer.Option(help="host name of this server, in addition to its addresses")
    ] = None,
    first_key: Annotated[
        Path | None, typer.Option(help="create an operator key in this file if it does not exist")
    ] = None,
    wait_for_address: Annotated[
        float, typer.Option(min=0.0, help="at boot: how long to wait for the network address [s]")
    ] = 0.0,
) -> None:
    """Start the server: panel, REST, link and vision processes."""
    from rich.console import Console  # all of this here: --help needs none of it, and it takes seconds
    from rich.markup import escape

    from longreach.processes import require_bindable
    from server.access.keys import first_key as make_first_key
    from server.access.roles import Role
    from server.settings import read_settings
    from server.settings_camera import with_stream
    from server.version import __version__

    file = read_settings(settings_file)
    settings = _with_options(
        file,
        {
            "http": {"host": host, "port": port, "keys_file": keys, "allowed_hosts": allow_host or None},
            "plc": {"host": plc_host, "port": plc_port, "local_port": plc_local_port},
            "camera": with_stream(file.camera, camera_url),
            "recording": {"folder": runs},
        },
    )
    keys_file, screen = settings.http.keys_file, Console(stderr=True)
    require_bindable(addresses_of(settings), wait_for_address, lambda text: screen.print(escape(text), soft_wrap=True))
    from server.app import serve as run_server  # seconds: what is refused is refused before them

    if first_key and keys_file and make_first_key(Path(keys_file), Role.OPERATOR, first_key):
        screen.print(f"a first key was made: it is in {first_key}")
    address = f"http://{settings.http.host}:{settings.http.port}/"
    run_server(settings, lambda: screen.print(f"longreach {__version__}: panel at {address}"))


def addresses_of(settings: "ServerSettings") -> "tuple[Address, ...]":
    """All that the server listens on."""
    from longreach.processes import Address

    http, plc = settings.http, settings.plc
    taken_by = "another program, perhaps another server or `longreach commission`; give another one"
    found = (
        Address(http.host, http.port, "--host", "--port"),
        Address.of_plc_link(plc.local_host, plc.local_port, taken_by),
    )
    faces = (("opcua", settings.opcua), ("foxglove", settings.foxglove))
    wanted = (Address(f.host, f.port, f"[{name}] host", f"[{name}] port") for name, f in faces if f.enabled)
    return (*found, *wanted)


def _with_options(settings: "ServerSettings", options: dict[str, dict[str, object]]) -> "ServerSettings":
    from pydantic import ValidationError

    from server.errors import SettingsError
    from server.settings import first_problem

    data = settings.model_dump()
    for section, values in options.items():
        given = {name: value for name, value in values.items() if value is not None}
        data[section] = given if section == "camera" else {**data[section], **given}
    try:
        return type(settings).model_validate(data)
    except ValidationError as error:
        raise SettingsError(f"command line: {first_problem(error)}") from error
