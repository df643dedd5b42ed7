"""HEAD wherever there is GET, as load balancers and monitors ask: the same status and headers, without the body."""

import asyncio

from starlette.types import ASGIApp, Message, Receive, Scope, Send


class Head:
    """ASGI middleware: a HEAD is worked on as the GET would be, until its headers are there."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One connection."""
        if scope["type"] != "http" or scope["method"] != "HEAD":
            return await self._app(scope, receive, send)
        begun = asyncio.Event()

        async def headers_only(message: Message) -> None:
            if message["type"] == "http.response.start":
                await send(message)
                await send({"type": "http.response.body", "body": b"", "more_body": False})
                begun.set()

        async with asyncio.TaskGroup() as tasks:
            answering = tasks.create_task(self._answer({**scope, "method": "GET"}, receive, headers_only))
            waiting = tasks.create_task(begun.wait())
            await asyncio.wait({answering, waiting}, return_when=asyncio.FIRST_COMPLETED)
            for task in (answering, waiting):  # a stream of events would go on without end
                task.cancel()

    async def _answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        await self._app(scope, receive, send)
