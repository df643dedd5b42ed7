"""Errors as RFC 9457 problem details: what is wrong, a stable code, what to do, facts for programs."""

import logging

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from starlette.routing import compile_path

from server.access.errors import AccessError
from server.api.views import Problem
from server.camera.errors import CameraError
from server.errors import BusyError, JobFailedError, PlanRefusedError, ServerError
from server.link.errors import LinkError
from server.store.database import StoreError

log = logging.getLogger(__name__)
HTTP_STATUS_BY_ERROR = {CameraError: 503, BusyError: 409, PlanRefusedError: 409, JobFailedError: 409}
PROBLEM_CODE_BY_HTTP_STATUS = {400: "unreadable_body", 404: "unknown_path", 405: "method_not_allowed"}
HINT_BY_HTTP_STATUS = {
    400: "send JSON in UTF-8 with Content-Type: application/json",
    404: "see /v1/openapi.json for the available paths",
    405: "see /v1/openapi.json for the methods of this path",
}


def problem_response(
    status: int, title: str, detail: str, code: str, hint: str = "", references: dict[str, str] | None = None
) -> JSONResponse:
    """One problem+json answer."""
    body = Problem(title=title, status=status, detail=detail, code=code, hint=hint, references=references or {})
    return JSONResponse(body.model_dump(), status_code=status, media_type="application/problem+json")


def problem_of(error: ServerError) -> JSONResponse:
    """The answer to one of our own errors."""
    return problem_response(status_of(error), title_of(error), str(error), error.code, error.hint, error.references)


def status_of(error: ServerError) -> int:
    """The HTTP status of an error."""
    if isinstance(error, AccessError):
        return error.status
    if isinstance(error, StoreError):
        return 503
    return next((status for kind, status in HTTP_STATUS_BY_ERROR.items() if isinstance(error, kind)), 400)


def title_of(error: ServerError) -> str:
    """The kind of an error in words: BodyTooLargeError is "Body too large"."""
    words = "".join(f" {letter.lower()}" if letter.isupper() else letter for letter in type(error).__name__)
    return words.strip().removesuffix(" error").capitalize()


def install_problem_handlers(app: FastAPI) -> None:
    """Make every error a problem; a defect is 500, logged, and shows nothing of the inside."""

    @app.exception_handler(ServerError)
    async def server_error(_request: Request, error: ServerError) -> JSONResponse:
        return problem_of(error)

    @app.exception_handler(LinkError)
    async def link_error(_request: Request, error: LinkError) -> JSONResponse:
        return problem_response(503, "PLC link", str(error), "link", "check the PLC, its cable and the [plc] settings")

    @app.exception_handler(HTTPException)
    async def refused(request: Request, error: HTTPException) -> JSONResponse:
        status = error.status_code
        code, hint = PROBLEM_CODE_BY_HTTP_STATUS.get(status, "http_error"), HINT_BY_HTTP_STATUS.get(status, "")
        answer = problem_response(status, "Refused", str(error.detail), code, hint)
        for name, value in (error.headers or {}).items():
            answer.headers[name] = value
        if status == 405 and (methods := _methods_of(app, request.scope["path"])):
            answer.headers["Allow"] = ", ".join(sorted(methods))
        return answer

    @app.exception_handler(RequestValidationError)
    async def invalid(_request: Request, error: RequestValidationError) -> JSONResponse:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        if first["type"] == "json_invalid":
            return problem_response(
                400,
                "Unreadable body",
                f"{where}: {first['msg']}",
                PROBLEM_CODE_BY_HTTP_STATUS[400],
                HINT_BY_HTTP_STATUS[400],
            )
        hint = "see /v1/openapi.json for the request's fields"
        detail = first["msg"]
        if first["type"] == "union_tag_invalid":  # pydantic's words hold what was sent; nothing that was sent is echoed
            detail = f"'kind' must be one of {first['ctx']['expected_tags']}"
        detail += _number_sent(first.get("input"))
        return problem_response(422, "Invalid request", f"{where}: {detail}"[:500], "invalid_request", hint)

    @app.exception_handler(Exception)
    async def defect(request: Request, error: Exception) -> JSONResponse:
        log.error("defect at %s %s", request.method, request.scope.get("route", ""), exc_info=error)
        return problem_response(500, "Defect", "internal error; see the server's log", "internal", "report it, please")


def _number_sent(value: object) -> str:
    """The value that was refused, where it is a number; text that was sent is echoed nowhere."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e15:
        return ""
    return f" (sent: {value:.6g})"


def _methods_of(app: FastAPI, path: str) -> set[str]:
    """All methods of a path, as our document has them; starlette's own Allow names those of one route only.

    A path that is written out in the document is itself: /v1/lease/ask is not a lease with the name `ask`.
    """
    found: set[str] = set()
    paths = app.openapi().get("paths", {})
    for template, operations in {path: paths[path]}.items() if path in paths else paths.items():
        if compile_path(template)[0].match(path):
            found |= {method.upper() for method in operations}
    return found
