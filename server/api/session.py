"""Logging in with a browser: a key once, then a cookie that no script reads and no other page sends."""

from urllib.parse import parse_qs

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse, RedirectResponse, Response

from recording.clock import mono_s
from server.access.gatekeeper import Gatekeeper
from server.access.sessions import SESSION_COOKIE_NAME, SESSION_LIFETIME_S
from server.api.callers import caller_of
from server.api.guard import credentials_of
from server.api.views import Problem, View

LOGIN_CSP = "default-src 'none'; form-action 'self'; frame-ancestors 'none'; base-uri 'none'"
LOGIN_HEADERS = {
    "Content-Security-Policy": LOGIN_CSP,
    "Cache-Control": "no-store",
    "Referrer-Policy": "same-origin",  # by no-referrer the forms of a page have the origin null
}
LOGIN_PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>longreach: log in</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<h1>longreach</h1>
<form method="post" action="v1/session">
<p><label>Key <input name="key" type="password" autocomplete="current-password" required autofocus></label>
<button>Log in</button></p>
<p>Keys are made on the server with <code>longreach keys add</code>.</p>
</form>
<form method="post" action="v1/stop"><p><button>Stop motion (software)</button></p></form>
</html>
"""


class WhoView(View):
    """Who this request is taken for."""

    name: str
    role: str


def session_router(gatekeeper: Gatekeeper, *, secure: bool) -> APIRouter:
    """Routes /login and /v1/session. `secure`: the browser speaks TLS to a proxy in front of us."""
    router = APIRouter(tags=["session"])

    @router.get("/login", include_in_schema=False)
    async def login() -> HTMLResponse:
        return HTMLResponse(LOGIN_PAGE, headers=LOGIN_HEADERS)

    @router.get("/v1/session", response_model=WhoView)
    async def read_who(request: Request) -> WhoView:
        """Name and role of the caller."""
        caller = caller_of(request)
        return WhoView(name=caller.name, role=caller.role)

    @router.post(
        "/v1/session",
        status_code=303,
        response_class=Response,
        responses=LOGIN_RESPONSES,
        openapi_extra=LOGIN_FORM_OPENAPI,
    )
    async def log_in(request: Request) -> Response:
        """Exchange a key (form field `key`) for the session cookie, then go to the panel."""
        address = credentials_of(request.scope).address
        token = gatekeeper.log_in(_key_field(await request.body()), address, mono_s())
        answer = RedirectResponse("../", status_code=303)  # seen from /v1/session, under whatever path of a proxy
        answer.set_cookie(
            SESSION_COOKIE_NAME,
            token,
            max_age=int(SESSION_LIFETIME_S),
            httponly=True,
            samesite="strict",
            secure=secure,
            path="/",
        )
        return answer

    @router.delete("/v1/session", status_code=204, response_class=Response)
    async def log_out(request: Request) -> Response:
        """End the session of this cookie."""
        gatekeeper.sessions.close(credentials_of(request.scope).cookie)
        answer = Response(status_code=204)
        answer.delete_cookie(SESSION_COOKIE_NAME, path="/")
        return answer

    return router


def _key_field(body: bytes) -> str:
    try:
        fields = parse_qs(body.decode("utf-8", "replace"), max_num_fields=4)
    except ValueError:  # more fields than the form has
        return ""
    return fields.get("key", [""])[0].strip()


LOGIN_FORM_OPENAPI = {
    "requestBody": {
        "required": True,
        "content": {
            "application/x-www-form-urlencoded": {
                "schema": {"type": "object", "properties": {"key": {"type": "string"}}, "required": ["key"]}
            }
        },
    }
}
LOGIN_RESPONSES: dict[int | str, dict[str, object]] = {
    303: {"description": "logged in; the cookie is set"},
    401: {"model": Problem, "description": "the key is wrong or was revoked"},
    429: {"model": Problem, "description": "too many wrong keys from this address"},
}
