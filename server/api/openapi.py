"""The OpenAPI document: what every operation may answer because of the guard, problems with their media type, keys."""

import re
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from server.access.roles import ANYBODY, Role, roles_needed
from server.api.examples import with_examples

PROBLEM_CONTENT = {"application/problem+json": {"schema": {"$ref": "#/components/schemas/Problem"}}}
GUARD_STATUS_DESCRIPTIONS = {
    "400": "the request cannot be read",
    "401": "no key, or an invalid one",
    "403": "role not permitted, no control, or a request from another web page",
    "408": "the body did not arrive in time",
    "413": "the body is too large",
    "421": "the Host header is not one of this server's names",
    "422": "the request is not as described here",
    "429": "too many wrong keys from this address",
    "500": "internal error; see the server's log",
}
KEY_HEADER_DESCRIPTION = "Authorization: Bearer KEY; not needed while the server listens on loopback without keys"


def install_openapi(app: FastAPI) -> None:
    """Make `app.openapi()` the complete document, made once."""

    def document() -> dict[str, Any]:
        if app.openapi_schema is None:
            made = get_openapi(title=app.title, version=app.version, routes=app.routes, description=API_DESCRIPTION)
            app.openapi_schema = complete_openapi(made)
        return app.openapi_schema

    app.openapi = document  # type: ignore[method-assign]


API_DESCRIPTION = """\
One machine, one server. Commands that can move or arm carry control (POST /v1/lease) in the headers
Longreach-Lease and Longreach-Fencing; a fleet's also an Idempotency-Key. POST /v1/stop needs nothing.
Errors are RFC 9457 problems with a stable `code`. WebSockets (/v1/live, /v1/hold, /v1/video) serve the panel and are
not part of this document."""

_CONTROL = {
    "lease_id": "$response.body#/lease_id",
    "header.longreach-lease": "$response.body#/lease_id",
    "header.longreach-fencing": "{$response.body#/fencing}",  # in braces: as text, which a header is
}
_HELD = ("PUT /v1/lease/{lease_id}", "DELETE /v1/lease/{lease_id}", "POST /v1/lease/{lease_id}/grant")
_JOB = ("GET /v1/jobs/{job_id}", "GET /v1/jobs/{job_id}/events", "POST /v1/jobs/{job_id}/cancel")
_DIAGNOSIS = ("GET /v1/diagnoses/{diagnosis_id}", "DELETE /v1/diagnoses/{diagnosis_id}")
PANEL_FILE_RESPONSES = {  # answers of the panel's own routes, in addition to the guard's: media type, refusals
    "/v1/panel/recordings/{name}/file": ("application/octet-stream", ("404",)),
    "/v1/panel/recordings/{name}/replay": ("application/json", ("404", "409")),
    "/v1/panel/recordings/{name}/pictures/{start}-{end}": ("image/jpeg", ("404",)),
}
_PANEL = ("PUT /v1/goal", "POST /v1/accept", "POST /v1/alarms/{code}/acknowledge")
_TARGET = ("POST /v1/target", "DELETE /v1/target")
_COMMANDS = ("POST /v1/jobs", "POST /v1/disarm", "POST /v1/reset", *_TARGET, *_PANEL)
LINKS: dict[tuple[str, str], tuple[dict[str, str], tuple[str, ...]]] = {
    ("/v1/lease", "201"): (_CONTROL, (*_HELD, *_COMMANDS)),
    ("/v1/lease/take", "201"): (_CONTROL, (*_HELD, *_COMMANDS)),
    ("/v1/jobs", "202"): ({"job_id": "$response.body#/job_id"}, _JOB),
    ("/v1/diagnoses", "202"): ({"diagnosis_id": "$response.body#/diagnosis_id"}, _DIAGNOSIS),
}


def complete_openapi(document: dict[str, Any]) -> dict[str, Any]:
    """The document with what the guard adds."""
    document["components"]["securitySchemes"] = {
        "key": {"type": "http", "scheme": "bearer", "description": KEY_HEADER_DESCRIPTION}
    }
    for name in ("HTTPValidationError", "ValidationError"):
        document["components"]["schemas"].pop(name, None)
    _describe_files(document["paths"])
    _shorten_operation_ids(document["paths"])
    with_examples(document)
    _add_response_links(document["paths"])
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            _add_errors_and_roles(operation, method.upper(), path)
    return document


def _shorten_operation_ids(paths: dict[str, Any]) -> None:
    """Operations by their short names, which generated clients make their functions of: a test holds them apart."""
    for path, operations in paths.items():
        for method, operation in operations.items():
            made_longer = re.sub(r"\W", "_", path) + f"_{method}"  # as FastAPI does
            operation["operationId"] = operation["operationId"].removesuffix(made_longer)


def _describe_files(paths: dict[str, Any]) -> None:
    """Answers that are files or not a model of ours, and how they are refused; without a panel there are none."""
    for path, (media_type, refusals) in PANEL_FILE_RESPONSES.items():
        if path in paths:
            responses = paths[path]["get"]["responses"]
            kind = {"type": "object"} if media_type == "application/json" else {"type": "string"}
            responses["200"]["content"] = {media_type: {"schema": kind}}
            for status in refusals:
                responses.setdefault(status, {"description": "it does not exist, or cannot be read"})
            for parameter in paths[path]["get"].get("parameters", ()):
                if parameter["schema"].get("type") == "integer":
                    parameter["schema"]["minimum"] = (
                        0  # a place in the run: a minus sign would be read as the one between
                    )


def _add_response_links(paths: dict[str, Any]) -> None:
    """Say which answer gives what another request takes (OpenAPI links): control, jobs, diagnoses."""
    for (path, status), (source, targets) in LINKS.items():
        links = {}
        for target in targets:
            method, _, to = target.partition(" ")
            if to not in paths:  # an application without a panel
                continue
            label = f"{method.lower()}{to.replace('/', '_').replace('{', '').replace('}', '')}"
            there = paths[to][method.lower()]
            taken = {parameter["name"].lower() for parameter in there.get("parameters", ())}
            given = {name: value for name, value in source.items() if name.split(".")[-1] in taken}
            links[label] = {"operationId": there["operationId"], "parameters": given}
        paths[path]["post"]["responses"][status]["links"] = links


def _add_errors_and_roles(operation: dict[str, Any], method: str, path: str) -> None:
    responses = operation["responses"]
    for status, text in GUARD_STATUS_DESCRIPTIONS.items():
        if status not in responses or "HTTPValidationError" in str(responses[status]):
            responses[status] = {"description": text}
    for status, response in responses.items():
        described = str(response.get("content", ""))
        if status >= "400" and (not described or "schemas/Problem" in described):
            response["content"] = PROBLEM_CONTENT
    roles = roles_needed(method, path)
    if roles != ANYBODY:
        operation["security"] = [{"key": []}]
        wanted = ", ".join(role.value for role in Role if role in roles)
        operation["description"] = f"{operation.get('description', '')}\n\nRoles: {wanted}.".strip()
