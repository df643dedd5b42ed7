"""`longreach keys ...`: the API keys of a server that others than this computer reach."""

import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from server.access.keys import new_key, read_keys, with_key, without_key, write_keys
from server.access.roles import Role

app = typer.Typer(no_args_is_help=True)
Name = Annotated[str, typer.Argument(help="whose key it is; shown in the audit")]
File = Annotated[Path, typer.Option("--file", help="the key file that [http] keys_file names")]
DEFAULT_KEYS_FILE = Path("keys.json")


@app.command()
def add(
    name: Name,
    role: Annotated[Role, typer.Option(help="what the key may do")] = Role.OPERATOR,
    file: File = DEFAULT_KEYS_FILE,
) -> None:
    """Make a key and print it once; only its SHA-256 is stored."""
    secret = new_key()
    write_keys(file, with_key(read_keys(file), name, role, secret, time.time()))
    Console(stderr=True).print(f"key of {name} ({role}), shown only once; send it as 'Authorization: Bearer KEY'")
    typer.echo(secret)


@app.command("list")
def list_keys(file: File = DEFAULT_KEYS_FILE) -> None:
    """List names, roles and dates, without the keys."""
    table = Table()
    for heading in ("name", "role", "made", "revoked"):
        table.add_column(heading)
    for key in read_keys(file):
        revoked = "" if key.revoked_unix_s is None else _utc_date_text(key.revoked_unix_s)
        table.add_row(key.name, key.role, _utc_date_text(key.made_unix_s), revoked)
    Console().print(table)


@app.command()
def revoke(name: Name, file: File = DEFAULT_KEYS_FILE) -> None:
    """Revoke a key; a running server applies it within a second and ends its sessions."""
    write_keys(file, without_key(read_keys(file), name, time.time()))
    typer.echo(f"key of {name} revoked")


def _utc_date_text(t_unix_s: float) -> str:
    return datetime.fromtimestamp(t_unix_s, UTC).strftime("%Y-%m-%d %H:%M UTC")
