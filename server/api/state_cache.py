"""The state as JSON text, made at most 20 times a second however many ask."""

from collections.abc import Callable

from starlette.responses import Response
from starlette.routing import Route
from starlette.types import Receive, Scope, Send

from recording.clock import mono_s
from server.api.state_view import state_view
from server.jobs.service import JobService

FRESH_S = 0.05


class StateCache:
    """Belongs to the event loop."""

    def __init__(self, service: JobService, clock: Callable[[], float] = mono_s) -> None:
        self._service, self._clock = service, clock
        self._text, self._made_s = "", float("-inf")

    def text(self) -> str:
        """Not older than FRESH_S."""
        now_s = self._clock()
        if now_s - self._made_s > FRESH_S:
            service = self._service
            self._text = state_view(
                service.cell, service.engine, service.context, service.store_problem
            ).model_dump_json()
            self._made_s = now_s
        return self._text

    def answer(self) -> Response:
        """The text as an answer to a GET."""
        return Response(self.text(), media_type="application/json", headers={"Cache-Control": "no-store"})


class StraightState:
    """GET /v1/state as an ASGI application: what fleets ask most often, without the framework's share of its cost."""

    def __init__(self, states: StateCache) -> None:
        self._states = states

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request."""
        await self._states.answer()(scope, receive, send)


def straight_route(states: StateCache) -> Route:
    """To stand before the documented route of the same path, which describes this one's answers in the document."""
    route = Route("/v1/state", StraightState(states), include_in_schema=False)
    route.methods = {"GET"}  # Starlette adds HEAD, which the document does not have
    return route
