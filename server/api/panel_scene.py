"""The 3D view on the API's port: feeds the scene's process, passes its page and socket on, and outlives its death."""

import asyncio
import contextlib
import logging

import httpx
import numpy as np
import websockets
from fastapi import APIRouter, Request, Response, WebSocket, WebSocketDisconnect

from machine.poses import inverse_pose, transform_points
from machine.rotations import Array
from recording.clock import mono_s
from server.api.callers import same_origin
from server.api.panel_memory import PanelMemory
from server.jobs.knowledge import PreviewedPlan
from server.jobs.plans.looking import mount_rotation
from server.jobs.service import JobService
from web.scene_process import SceneGoneError, SceneProcess
from web.scene_view import PlanShown, SceneView

log = logging.getLogger(__name__)

SCENE_UPDATE_PERIOD_S = 1.0 / 15.0
SCENE_PICTURE_PERIOD_S = 1.0
RESTART_DELAY_S = 3.0
PLAN_PATH_POINTS_MAX = 60
VISER_MESSAGE_MAX_BYTES = 64 * 2**20  # viser sends whole scenes in one message
VIEW_CSP = (
    "default-src 'self' blob: data:; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob:; "
    "style-src 'self' 'unsafe-inline'; frame-ancestors 'self'"
)  # viser's own page is one file with its scripts inside; nothing of it may be loaded from elsewhere
VIEW_HEADERS = {
    "Content-Security-Policy": VIEW_CSP,
    "Document-Isolation-Policy": "isolate-and-require-corp",  # a process of its own in the browser: without a graphics
    # card the 3D view held up the page around it, with its STOP and its hold-to-run, for seconds
}
EMBEDDED_SCENE_HTML = (
    b"<style>.mantine-Notifications-root, .mantine-Paper-root { display: none !important }</style>"
    b'<script>addEventListener("keydown", (event) => { if (event.key === "Escape" && !event.repeat) {'
    b' fetch(new URL("../v1/stop", document.baseURI), { method: "POST", keepalive: true }).catch(() => {});'
    b' parent.postMessage("stop", location.origin); } }, true)</script>'
)  # the page around it hears no key while the view has the focus


class SceneFeed:
    """Keeps one scene process alive and shows it the newest state."""

    def __init__(self, service: JobService, memory: PanelMemory) -> None:
        self._service, self._memory = service, memory
        self._process: SceneProcess | None = None
        self._picture_s = 0.0
        self._plan: tuple[PreviewedPlan, PlanShown] | None = None
        self._track: tuple[object, Array | None, Array | None] = ((), None, None)
        self._map: tuple[object, Array | None] = (None, None)

    @property
    def port(self) -> int | None:
        """Viser's loopback port while it runs."""
        return self._process.port if self._process is not None else None

    async def run(self) -> None:
        """Until cancelled; a scene that ends is started again."""
        try:
            while True:
                await self._one_life()
                await asyncio.sleep(RESTART_DELAY_S)
        finally:
            await asyncio.shield(asyncio.to_thread(self._close_process))

    async def _one_life(self) -> None:
        process = SceneProcess(self._service.cell.machine)
        try:
            await asyncio.to_thread(process.start)
            self._process = process
            self._set_scene_status(running=True, problem="", process_id=process.process_id)
            while True:
                view = self._scene_view()
                if view is not None:
                    process.show(view)
                elif process.process_id is None:
                    raise SceneGoneError("the 3D view's process has ended")
                await asyncio.sleep(SCENE_UPDATE_PERIOD_S)
        except SceneGoneError as error:
            log.error("%s; the page continues without it, it restarts in %s s", error, RESTART_DELAY_S)
            self._set_scene_status(running=False, problem=str(error), process_id=None)
        except Exception:  # the scene is an extra: the page with its STOP must go on without it
            log.exception("the 3D view failed")
            self._set_scene_status(running=False, problem="the 3D view failed; see the server's log", process_id=None)
        finally:
            self._process = None
            await asyncio.shield(asyncio.to_thread(process.close))

    def _close_process(self) -> None:
        if self._process is not None:
            self._process.close()

    def _set_scene_status(self, running: bool, problem: str, process_id: int | None) -> None:
        update = {"running": running, "problem": problem, "process_id": process_id}
        self._memory.scene_state = self._memory.scene_state.model_copy(update=update)

    # --- what is shown ----------------------------------------------------------------------------------------------

    def _scene_view(self) -> SceneView | None:
        cell, ctx = self._service.cell, self._service.context
        latest = cell.link.latest
        if latest is None:
            return None
        T_base_tcp = ctx.tcp(np.array(latest.q_rad))
        T_tcp_cam = cell.machine.T_tcp_cam_left.copy()
        if cell.knowledge.last_look is not None:
            T_tcp_cam[:3, :3] = mount_rotation(ctx, cell.knowledge.last_look)
        T_base_cam = T_base_tcp @ T_tcp_cam
        return SceneView(
            q_rad=latest.q_rad,
            T_base_cam=T_base_cam,
            T_base_tool=T_base_tcp @ cell.machine.T_tcp_tool,
            T_base_ooi=cell.knowledge.T_base_ooi,
            plan=self._plan_shown(cell.knowledge.previewed_plan),
            scrub_frac=self._memory.scene_state.scrub_frac,
            track_base_m=self._track_shown(T_base_cam),
            map_base_m=self._map_shown(),
            picture_jpeg=self._preview_if_due(),
        )

    def _plan_shown(self, previewed: PreviewedPlan | None) -> PlanShown | None:
        if previewed is None:
            return None
        if self._plan is None or self._plan[0] is not previewed:
            self._plan = previewed, plan_shown(previewed, self._service.cell.machine.T_tcp_tool)
            self._memory.scrub(1.0)
        return self._plan[1]

    def _track_shown(self, T_base_cam: Array) -> Array | None:
        """The camera's own way in the last calibration run, laid so that its end is where the camera was then."""
        poses = self._service.cell.vision.last_odometry
        if poses is not self._track[0]:
            track = T_base_vo = None
            if poses:
                T_base_vo = T_base_cam @ inverse_pose(poses[-1].T_vo_cam)
                picked = poses[:: max(1, len(poses) // PLAN_PATH_POINTS_MAX)]
                track = np.array([(T_base_vo @ pose.T_vo_cam)[:3, 3] for pose in picked])
            self._track = poses, track, T_base_vo
        return self._track[1]

    def _map_shown(self) -> Array | None:
        """The points that it went by, where its own way is laid."""
        found, T_base_vo = self._service.cell.vision.last_map, self._track[2]
        if found is not self._map[0]:
            points_base = None
            if found is not None and T_base_vo is not None:
                points_base = transform_points(T_base_vo, found.points_vo)
            self._map = found, points_base
        return self._map[1]

    def _preview_if_due(self) -> bytes | None:
        preview, now_s = self._service.cell.vision.latest_preview, mono_s()
        if preview is None or now_s - self._picture_s < SCENE_PICTURE_PERIOD_S:
            return None
        self._picture_s = now_s
        return preview[0]


def plan_shown(previewed: PreviewedPlan, T_tcp_tool: Array) -> PlanShown:
    """Sixty points of the plan; the ellipsoid stands at the tool's predicted place, along the goal's axes."""
    trajectory, poses = previewed.plan.trajectory, previewed.plan.Ts_base_tcp
    picked = np.linspace(0, len(poses) - 1, min(len(poses), PLAN_PATH_POINTS_MAX)).astype(int)
    qs = previewed.q_goal[None, :]
    if trajectory is not None:
        qs = trajectory.q[np.linspace(0, len(trajectory.q) - 1, PLAN_PATH_POINTS_MAX).astype(int)]
    return PlanShown(
        name=previewed.plan_hash,
        qs_rad=np.array(qs),
        path_base_m=poses[picked, :3, 3],
        T_base_ellipsoid=previewed.T_base_tcp_goal @ T_tcp_tool,
        ellipsoid_radii_m=2e-3 * np.array(previewed.predicted_sigma_mm),
    )


# --- the way through ------------------------------------------------------------------------------------------------


def scene_router(feed: SceneFeed) -> APIRouter:
    """Routes /view and /view/...: viser behind our port, with our check of the Origin."""
    router = APIRouter()

    @router.get("/view/{path:path}", include_in_schema=False)
    async def view(request: Request, path: str) -> Response:
        if feed.port is None:
            return Response("the 3D view is not running; everything else works", status_code=503)
        return await _proxy_page(request.app.state.viser_http, feed.port, path)

    @router.websocket("/view")
    @router.websocket("/view/{path:path}")
    async def view_socket(socket: WebSocket) -> None:
        if not same_origin(socket) or feed.port is None:
            await socket.close(code=4403, reason="foreign origin or no 3D view")
            return
        await _proxy_socket(socket, feed.port)

    return router


async def _proxy_page(client: httpx.AsyncClient, port: int, path: str) -> Response:
    try:
        answer = await client.get(f"http://127.0.0.1:{port}/{path}")
    except httpx.TransportError:
        return Response("the 3D view does not answer; everything else works", status_code=503)
    kept = {name: value for name, value in answer.headers.items() if name.lower() in ("content-type", "etag")}
    return Response(embedded_scene_page(answer.content), answer.status_code, headers=kept | VIEW_HEADERS)


def embedded_scene_page(page: bytes) -> bytes:
    """Viser's page as it is shown in ours: Esc stops there, too; its notices and its empty panel do not cover it."""
    return page.replace(b"</head>", EMBEDDED_SCENE_HTML + b"</head>", 1)


async def _proxy_socket(socket: WebSocket, port: int) -> None:
    """Both ways until either side closes; viser refuses other client versions by subprotocol: it passes through."""
    wanted = socket.scope.get("subprotocols") or []
    try:
        async with websockets.connect(
            f"ws://127.0.0.1:{port}",
            subprotocols=[websockets.Subprotocol(name) for name in wanted],
            max_size=VISER_MESSAGE_MAX_BYTES,
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
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):  # the page has gone already
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
