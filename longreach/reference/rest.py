"""The REST endpoints with their roles, and every code that an error can carry."""

import ast
import inspect
import tempfile
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import server.api
from longreach.reference.markdown import code, table
from server.access.roles import ANYBODY, Role, needed
from server.api.problems import HTTP_CODES, status_of
from server.app import build_app
from server.errors import ServerError
from server.settings import RecordingSettings, ServerSettings

ERROR_MODULES = (
    "server.access.errors",
    "server.access.gatekeeper",
    "server.api.guard",
    "server.api.hold_rule",
    "server.api.job_commands",
    "server.errors",
    "server.store.errors",
    "server.store.idempotency",
)


def document() -> dict[str, Any]:
    """The OpenAPI document of a server with default settings; nothing is started."""
    with tempfile.TemporaryDirectory() as folder:
        return build_app(ServerSettings(recording=RecordingSettings(folder=folder))).openapi()


def endpoints() -> str:
    """Every operation in the document's order."""
    rows = []
    for path, operations in document()["paths"].items():
        for method, operation in operations.items():
            rows.append(_endpoint(method.upper(), path, operation))
    return table(("request", "what", "answers", "roles"), rows)


def _endpoint(method: str, path: str, operation: dict[str, Any]) -> tuple[str, str, str, str]:
    good = [status for status in operation["responses"] if status < "400"]
    what = operation.get("description", operation["summary"]).split("\n\nRoles:")[0]
    roles = needed(method, path)
    some = "anyone" if roles == ANYBODY else ", ".join(role.value for role in Role if role in roles)
    return code(f"{method} {path}"), what, ", ".join(good), "all" if len(roles) == len(Role) else some


def error_codes() -> str:
    """Codes of problems: of our errors, of plain refusals in the routes, of HTTP itself."""
    found = {**{code: (status, "") for status, code in _http_codes()}, **dict(_in_routes()), **dict(_of_errors())}
    rows = [(code(name), str(status), hint) for name, (status, hint) in sorted(found.items())]
    return table(("code", "status", "what to do"), rows)


def _http_codes() -> Iterator[tuple[int, str]]:
    yield from HTTP_CODES.items()
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
