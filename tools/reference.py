"""`python -m tools.reference`: writes docs/reference.md: REST, commands, settings, alarms and codes."""

import ast
import inspect
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, get_args

import typer
from pydantic import BaseModel
from pydantic_core import PydanticUndefined

import server.api
from longreach.lazy_commands import LazyCommand, loaded_command
from longreach.settings_command import bounds_text, models_of, type_text
from protocol.codes import FaultBit, RejectCode, reject_text
from server.access.roles import ANYBODY, Role, roles_needed
from server.api.panel_alarm_catalogue import CATALOGUE
from server.api.problems import PROBLEM_CODE_BY_HTTP_STATUS, status_of
from server.app import build_app
from server.errors import ServerError
from server.settings import RecordingSettings, ServerSettings

# The REST endpoints with their roles, and every code that an error can carry.

# fmt: off
ERROR_MODULES = (
    "server.access.errors", "server.access.gatekeeper", "server.api.guard", "server.api.hold_rule",
    "server.api.job_commands", "server.errors", "server.store.database", "server.store.idempotency",
)
# fmt: on


def document() -> dict[str, Any]:
    """The OpenAPI document of a server with default settings; nothing is started."""
    with tempfile.TemporaryDirectory() as folder:
        return build_app(ServerSettings(recording=RecordingSettings(folder=folder))).openapi()


def table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; cells on one line, bars escaped."""
    lines = [_markdown_row(headings), _markdown_row(["---"] * len(headings)), *(_markdown_row(cells) for cells in rows)]
    return "\n".join(lines)


def _markdown_row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(" ".join(cell.split()).replace("|", "\\|") for cell in cells) + " |"


def code(text: str) -> str:
    """As code; empty stays empty."""
    return f"`{text}`" if text else ""


def endpoint_table() -> str:
    """Every operation in the document's order."""
    rows = []
    for path, operations in document()["paths"].items():
        for method, operation in operations.items():
            rows.append(_endpoint_row(method.upper(), path, operation))
    return table(("request", "what", "answers", "roles"), rows)


def _endpoint_row(method: str, path: str, operation: dict[str, Any]) -> tuple[str, str, str, str]:
    good = [status for status in operation["responses"] if status < "400"]
    what = operation.get("description", operation["summary"]).split("\n\nRoles:")[0]
    roles = roles_needed(method, path)
    some = "anyone" if roles == ANYBODY else ", ".join(role.value for role in Role if role in roles)
    return code(f"{method} {path}"), what, ", ".join(good), "all" if len(roles) == len(Role) else some


def error_codes() -> str:
    """Codes of problems: of our errors, of plain refusals in the routes, of HTTP itself."""
    found = {**{code: (status, "") for status, code in _http_codes()}, **dict(_in_routes()), **dict(_of_errors())}
    rows = [(code(name), str(status), hint) for name, (status, hint) in sorted(found.items())]
    return table(("code", "status", "what to do"), rows)


def _http_codes() -> Iterator[tuple[int, str]]:
    yield from PROBLEM_CODE_BY_HTTP_STATUS.items()
    yield 422, "invalid_request"


def _of_errors() -> Iterator[tuple[str, tuple[int, str]]]:
    for module in ERROR_MODULES:
        for _, kind in inspect.getmembers(import_module(module), inspect.isclass):
            if issubclass(kind, ServerError) and kind.__module__ == module and kind.code not in _NEVER_SENT:
                yield kind.code, (status_of(kind.__new__(kind)), kind.hint)


_NEVER_SENT = {"server_error", "access", "settings"}  # bases, and what ends a start instead of a request


def _in_routes() -> Iterator[tuple[str, tuple[int, str]]]:
    """Calls of `problem(status, title, detail, code, hint)` whose status and code are written out."""
    for file in sorted(Path(server.api.__path__[0]).glob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "problem":
                values = [argument.value if isinstance(argument, ast.Constant) else "" for argument in node.args]
                if len(values) >= 4 and isinstance(values[0], int) and values[3]:
                    yield str(values[3]), (values[0], str(values[4]) if len(values) > 4 else "")


OUT = Path("docs/reference.md")
ABOUT = """# Reference

Made from the code by `python -m tools.reference`; a test keeps it current. For explanations see
[rest.md](rest.md), [security.md](security.md), [plc-link.md](plc-link.md), [tutorial.md](tutorial.md).
"""


# Alarms of the panel, faults over REST by reference, reject codes and fault bits of the PLC.


def alarms() -> str:
    """Every alarm; each has a page of its own in docs/alarms/."""
    rows = [(code(alarm.code), alarm.level, alarm.title, alarm.remedy) for alarm in CATALOGUE.values()]
    return table(("code", "level", "what", "what to do"), rows)


def settings_tables() -> str:
    """One table for each section; the camera's depend on its kind."""
    parts = [table(_SETTING_HEADINGS, list(_plain_field_rows(ServerSettings)))]
    for name, field in ServerSettings.model_fields.items():
        models = models_of(field.annotation)
        for model in models:
            kind = f', kind = "{_kind_name(model)}"' if len(models) > 1 else ""
            rows = table(_SETTING_HEADINGS, list(_plain_field_rows(model)))
            parts.append(f"### [{name}]{kind}\n\n{_first_line(model)}\n\n{rows}")
    return "\n\n".join(parts)


_SETTING_HEADINGS = ("field", "type", "default", "bounds")


def _kind_name(model: type[BaseModel]) -> str:
    return str(get_args(model.model_fields["kind"].annotation)[0])


def _first_line(model: type[BaseModel]) -> str:
    return " ".join((model.__doc__ or "").split("\n\n")[0].split())


def _plain_field_rows(model: type[BaseModel]) -> Iterator[tuple[str, str, str, str]]:
    for name, field in model.model_fields.items():
        if not models_of(field.annotation) and name != "kind":
            default = "required" if field.default is PydanticUndefined else _value_text(field.default)
            yield code(name), type_text(field.annotation), default, bounds_text(field)


def _value_text(value: Any) -> str:
    return "" if value is None else code(str(value).lower() if isinstance(value, bool) else str(value))


def reject_code_table() -> str:
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

    return "\n\n".join(
        _command_section(path, command) for path, command in _walk_commands("longreach", typer.main.get_command(app))
    )


def _walk_commands(path: str, command: Any) -> Iterator[tuple[str, Any]]:
    command = loaded_command(command)
    children = getattr(command, "commands", None)  # typer's groups need not be click's own
    if children is None:
        yield path, command
        return
    for name in sorted(children):
        if isinstance(children[name], LazyCommand) and children[name].lazy.of_checkout:
            continue  # evidence: not part of the package
        yield from _walk_commands(f"{path} {name}", children[name])


def _command_section(path: str, command: Any) -> str:
    rows = [_parameter_row(parameter) for parameter in command.params if parameter.name != "help"]
    about = " ".join((command.help or "").split())
    return f"### {path}\n\n{about}" + (f"\n\n{table(('option', 'default', 'what'), rows)}" if rows else "")


def _parameter_row(one: Any) -> tuple[str, str, str]:
    names = one.name.upper() if one.param_type_name == "argument" else ", ".join([*one.opts, *one.secondary_opts])
    default = "required" if one.required else _default_text(one)
    return code(names), default, getattr(one, "help", None) or ""


def _default_text(one: Any) -> str:
    value = one.default() if callable(one.default) else one.default
    return "" if value is None or value is False or value == () else code(str(value))


def reference() -> str:
    """The whole page."""
    parts = (
        ("REST endpoints", endpoint_table()),
        ("REST error codes", error_codes()),
        ("Settings file", settings_tables()),
        ("Alarms", alarms()),
        ("Reject codes of the PLC link", reject_code_table()),
        ("Fault bits of the PLC", fault_bits()),
        ("Commands", commands()),
    )
    return ABOUT + "".join(f"\n## {title}\n\n{text}\n" for title, text in parts)


if __name__ == "__main__":
    OUT.write_text(reference(), encoding="utf-8")
    print(f"written: {OUT}")
