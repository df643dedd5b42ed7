"""Who sent a request: set by the guard in front of the application, read by the routes that write the audit."""

from collections.abc import Callable

from starlette.requests import HTTPConnection

from server.access.roles import Caller


def caller_of(request: HTTPConnection) -> Caller:
    """The caller that the guard recognised; without a guard, the operator at this computer."""
    known = getattr(request.state, "caller", None)
    if isinstance(known, Caller):
        return known
    return Caller(address=request.client.host if request.client else "")


def admission_of(request: HTTPConnection) -> Callable[[], bool]:
    """Whether this caller would be admitted now; always, without a guard."""
    still: Callable[[], bool] | None = getattr(request.state, "admitted_still", None)
    return still or (lambda: True)


def request_id_of(request: HTTPConnection) -> str:
    """The id under which this request is found in log and audit."""
    return str(getattr(request.state, "request_id", ""))
