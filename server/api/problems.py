"""Errors as RFC 9457 problem details."""

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from server.api.views import Problem
from server.errors import BusyError, JobFailedError, PlanRefusedError, ServerError
from server.link.errors import LinkError

STATUS = {BusyError: 409, PlanRefusedError: 409, JobFailedError: 409}


def problem(status: int, title: str, detail: str, code: str) -> JSONResponse:
    """One problem+json answer."""
    body = Problem(title=title, status=status, detail=detail, code=code)
    return JSONResponse(body.model_dump(), status_code=status, media_type="application/problem+json")


def install_problem_handlers(app: FastAPI) -> None:
    """Make every expected error a problem; defects stay 500 and are logged."""

    @app.exception_handler(ServerError)
    async def server_error(_request: Request, error: ServerError) -> JSONResponse:
        return problem(STATUS.get(type(error), 400), type(error).__name__, str(error), error.code)

    @app.exception_handler(LinkError)
    async def link_error(_request: Request, error: LinkError) -> JSONResponse:
        return problem(503, "PLC link", str(error), "link")

    @app.exception_handler(HTTPException)
    async def refused(_request: Request, error: HTTPException) -> JSONResponse:
        return problem(error.status_code, "Refused", str(error.detail), "http_error")

    @app.exception_handler(RequestValidationError)
    async def invalid(_request: Request, error: RequestValidationError) -> JSONResponse:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        return problem(422, "Invalid request", f"{where}: {first['msg']}", "invalid_request")
