"""Every subcommand with its arguments and options, from the command line's own description."""

from collections.abc import Iterator
from typing import Any

import typer

from longreach.lazy_commands import LazyCommand, loaded
from longreach.reference.markdown import code, table


def commands() -> str:
    """One table for each command."""
    from longreach.cli import app  # here: it imports this package

    return "\n\n".join(_described(path, command) for path, command in _walk("longreach", typer.main.get_command(app)))


def _walk(path: str, command: Any) -> Iterator[tuple[str, Any]]:
    command = loaded(command)
    children = getattr(command, "commands", None)  # typer's groups need not be click's own
    if children is None:
        yield path, command
        return
    for name in sorted(children):
        if isinstance(children[name], LazyCommand) and children[name].lazy.of_checkout:
            continue  # evidence: not part of the package
        yield from _walk(f"{path} {name}", children[name])


def _described(path: str, command: Any) -> str:
    rows = [_parameter(parameter) for parameter in command.params if parameter.name != "help"]
    about = " ".join((command.help or "").split())
    return f"### {path}\n\n{about}" + (f"\n\n{table(('option', 'default', 'what'), rows)}" if rows else "")


def _parameter(one: Any) -> tuple[str, str, str]:
    names = one.name.upper() if one.param_type_name == "argument" else ", ".join([*one.opts, *one.secondary_opts])
    default = "required" if one.required else _default(one)
    return code(names), default, getattr(one, "help", None) or ""


def _default(one: Any) -> str:
    value = one.default() if callable(one.default) else one.default
    return "" if value is None or value is False or value == () else code(str(value))
