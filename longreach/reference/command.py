"""`longreach docs`: write docs/reference.md, or say that it is out of date."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from longreach.lazy_commands import LazyCommand, loaded
from longreach.reference.fields import settings
from longreach.reference.markdown import code, table
from longreach.reference.rest import endpoints, error_codes
from protocol.codes import FaultBit, RejectCode, reject_text
from server.api.panel_alarm_catalogue import CATALOGUE

OUT = Path("docs/reference.md")
ABOUT = """# Reference

Made from the code by `longreach docs`; a test keeps it current. For explanations see
[rest.md](rest.md), [security.md](security.md), [plc-link.md](plc-link.md), [tutorial.md](tutorial.md).
"""


# Alarms of the panel, faults over REST by reference, reject codes and fault bits of the PLC.


def alarms() -> str:
    """Every alarm; each has a page of its own in docs/alarms/."""
    rows = [(code(alarm.code), alarm.level, alarm.title, alarm.remedy) for alarm in CATALOGUE.values()]
    return table(("code", "level", "what", "what to do"), rows)


def rejects() -> str:
    """Every reject code of the protocol."""
    rows = [(str(reject.value), code(reject.name), reject_text(reject).partition(": ")[2]) for reject in RejectCode]
    return table(("number", "code", "why"), rows)


def fault_bits() -> str:
    """Every latched fault of the PLC."""
    return table(("bit", "fault"), [(str(bit.value.bit_length() - 1), code(str(bit.name))) for bit in FaultBit])


# Every subcommand with its arguments and options, as the command line itself describes them.


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


def docs(
    out: Annotated[Path, typer.Option(help="output file")] = OUT,
    check: Annotated[bool, typer.Option("--check", help="write nothing; exit 1 when the file is out of date")] = False,
) -> None:
    """Write the reference of REST, commands, settings, alarms and codes."""
    text = reference()
    if check:
        if not out.is_file() or out.read_text(encoding="utf-8") != text:
            Console(stderr=True).print(f"{out} is out of date: run `longreach docs`")
            raise typer.Exit(1)
        return
    out.write_text(text, encoding="utf-8")
    Console().print(f"written: {out}")


def reference() -> str:
    """The whole page."""
    parts = (
        ("REST endpoints", endpoints()),
        ("REST error codes", error_codes()),
        ("Settings file", settings()),
        ("Alarms", alarms()),
        ("Reject codes of the PLC link", rejects()),
        ("Fault bits of the PLC", fault_bits()),
        ("Commands", commands()),
    )
    return ABOUT + "".join(f"\n## {title}\n\n{text}\n" for title, text in parts)
