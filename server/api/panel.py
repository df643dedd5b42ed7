"""The panel on the API's port: our page at /, its files at /static, and viser behind a proxy at /view."""

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable

import httpx
import numpy as np
import websockets
from fastapi import FastAPI, Request, Response, WebSocket
from fastapi.responses import FileResponse
from fastapi.staticfiles import StaticFiles

from server.api.live import same_origin
from server.jobs.plans.looking import mount_rotation
from server.jobs.service import JobService
from web import STATIC_FOLDER
from web.scene import Scene, SceneView

log = logging.getLogger(__name__)

SCENE_PERIOD_S = 1.0 / 15.0
VISER_MESSAGE_BYTES = 64 * 2**20  # viser sends whole scenes in one message
PAGE_CSP = (
    "default-src 'self'; img-src 'self' data: blob:; style-src 'self'; script-src 'self'; "
    "connect-src 'self' ws: wss:; frame-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
StopPanel = Callable[[], Awaitable[None]]


def install_panel(app: FastAPI, service: JobService) -> Callable[[FastAPI], Awaitable[StopPanel]]:
    """Add the routes; returns what starts the scene at the application's start and hands back how to stop it."""
    holder: dict[str, Scene] = {}

    @app.get("/", include_in_schema=False)
    async def page() -> FileResponse:
        headers = {
            "Content-Security-Policy": PAGE_CSP,
            "X-Content-Type-Options": "nosniff",
            "Cache-Control": "no-cache",
        }
        return FileResponse(STATIC_FOLDER / "index.html", headers=headers)

    @app.get("/view/{path:path}", include_in_schema=False)
    async def view(request: Request, path: str) -> Response:
        if "scene" not in holder:
            return Response("the 3D view is not running; everything else works", status_code=503)
        return await _proxy_page(request.app.state.viser_http, holder["scene"].port, path)

    @app.websocket("/view")
    @app.websocket("/view/{path:path}")
    async def view_socket(socket: WebSocket) -> None:
        if not same_origin(socket) or "scene" not in holder:
            await socket.close(code=4403, reason="foreign origin or no 3D view")
            return
        await _proxy_socket(socket, holder["scene"].port)

    app.mount("/static", StaticFiles(directory=STATIC_FOLDER), name="static")

    async def start(running: FastAPI) -> StopPanel:
        running.state.viser_http = httpx.AsyncClient(timeout=10.0)
        try:
            holder["scene"] = await asyncio.to_thread(Scene, service.cell.machine)
        except Exception:  # the scene is an extra: the page with its STOP must come up without it
            log.exception("the 3D view did not start")
        task = asyncio.create_task(_feed(service, holder), name="scene-feed")

        async def stop() -> None:
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task
            scene = holder.pop("scene", None)
            if scene is not None:
                await asyncio.to_thread(scene.close)
            await running.state.viser_http.aclose()

        return stop

    return start


async def _feed(service: JobService, holder: dict[str, Scene]) -> None:
    """Show the newest state at display rate; a fault of the scene is logged once and ends the scene only."""
    while "scene" in holder:
        view = _scene_view(service)
        if view is not None:
            try:
                holder["scene"].show(view)
            except Exception:  # see install_panel: never take the page along
                log.exception("the 3D view failed and was switched off")
                holder.pop("scene", None)
                return
        await asyncio.sleep(SCENE_PERIOD_S)


def _scene_view(service: JobService) -> SceneView | None:
    cell, ctx = service.cell, service.context
    latest = cell.link.latest
    if latest is None:
        return None
    T_base_tcp = ctx.tcp(np.array(latest.q_rad))
    T_tcp_cam = cell.machine.T_tcp_cam_left.copy()
    taken, plan = cell.knowledge.last_look, cell.knowledge.previewed
    if taken is not None:
        T_tcp_cam[:3, :3] = mount_rotation(ctx, taken)
    return SceneView(
        q_rad=latest.q_rad,
        T_base_cam=T_base_tcp @ T_tcp_cam,
        T_base_tool=T_base_tcp @ cell.machine.T_tcp_tool,
        T_base_ooi=cell.knowledge.T_base_ooi,
        q_goal_rad=tuple(float(value) for value in plan.q_goal) if plan else None,
        path_base_m=plan.plan.Ts_base_tcp[:, :3, 3] if plan else None,
    )


async def _proxy_page(client: httpx.AsyncClient, port: int, path: str) -> Response:
    try:
        answer = await client.get(f"http://127.0.0.1:{port}/{path}")
    except httpx.TransportError:
        return Response("the 3D view does not answer; everything else works", status_code=503)
    kept = {name: value for name, value in answer.headers.items() if name.lower() in ("content-type", "etag")}
    return Response(answer.content, answer.status_code, headers=kept | {"X-Frame-Options": "SAMEORIGIN"})


async def _proxy_socket(socket: WebSocket, port: int) -> None:
    """Both ways until either side closes; viser refuses other client versions by subprotocol: it passes through."""
    wanted = socket.scope.get("subprotocols") or []
    try:
        async with websockets.connect(
            f"ws://127.0.0.1:{port}",
            subprotocols=[websockets.Subprotocol(name) for name in wanted],
            max_size=VISER_MESSAGE_BYTES,
            max_queue=2,
            compression=None,
        ) as upstream:
            await socket.accept(subprotocol=upstream.subprotocol)
            down = asyncio.create_task(_pump_down(upstream, socket))
            up = asyncio.create_task(_pump_up(socket, upstream))
            _, pending = await asyncio.wait({down, up}, return_when=asyncio.FIRST_COMPLETED)
            for task in pending:
                task.cancel()
            await asyncio.gather(down, up, return_exceptions=True)
    except (OSError, websockets.WebSocketException) as error:
        log.info("3D view socket ended: %s", error)
    with contextlib.suppress(RuntimeError):
        await socket.close()


async def _pump_down(upstream: websockets.ClientConnection, socket: WebSocket) -> None:
    async for message in upstream:
        if isinstance(message, bytes):
            await socket.send_bytes(message)
        else:
            await socket.send_text(message)


async def _pump_up(socket: WebSocket, upstream: websockets.ClientConnection) -> None:
    while True:
        message = await socket.receive()
        if message["type"] == "websocket.disconnect":
            return
        payload = message.get("bytes")
        await upstream.send(payload if payload is not None else message["text"])
