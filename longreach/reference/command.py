"""`longreach docs`: write docs/reference.md, or say that it is out of date."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from longreach.reference.codes import alarms, fault_bits, rejects
from longreach.reference.commands import commands
from longreach.reference.fields import settings
from longreach.reference.rest import endpoints, error_codes

OUT = Path("docs/reference.md")
ABOUT = """# Reference

Made from the code by `longreach docs`; a test keeps it current. For explanations see
[rest.md](rest.md), [security.md](security.md), [plc-link.md](plc-link.md), [tutorial.md](tutorial.md).
"""


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
