"""HTTP interface of the simulated camera: multipart stream, snapshot, health, and fault switches if enabled."""

from collections.abc import AsyncIterator, Callable
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from sim_plc.camera.faults import FaultKind, FaultSwitch
from sim_plc.camera.frames import Frame, FrameHub

BOUNDARY = "longreach-frame"


class _FaultRequest(BaseModel):
    model_config = ConfigDict(extra="forbid")

    kind: FaultKind


def frame_headers(frame: Frame) -> dict[str, str]:
    """The stamps of a picture as HTTP headers."""
    return {"X-Exposure-Ns": str(frame.t_exposure_ns), "X-Sequence": str(frame.sequence)}


def multipart_part(frame: Frame) -> bytes:
    """One part of the stream: boundary, headers, picture."""
    headers = {"Content-Type": "image/jpeg", "Content-Length": str(len(frame.jpeg)), **frame_headers(frame)}
    lines = "".join(f"{name}: {value}\r\n" for name, value in headers.items())
    return f"--{BOUNDARY}\r\n{lines}\r\n".encode() + frame.jpeg + b"\r\n"


async def multipart_stream(hub: FrameHub) -> AsyncIterator[bytes]:
    """Parts for one client, newest picture only, until the camera shuts down."""
    with hub.subscribe() as subscriber:
        while (frame := await subscriber.next()) is not None:
            yield multipart_part(frame)
    yield f"--{BOUNDARY}--\r\n".encode()


def camera_app(hub: FrameHub, health: Callable[[], dict[str, Any]], faults: FaultSwitch | None) -> Starlette:
    """The application. `health`: the state, its key "status" is "ok" once pictures flow. `faults` None: refused."""

    async def stream(_request: Request) -> Response:
        media_type = f"multipart/x-mixed-replace; boundary={BOUNDARY}"
        return StreamingResponse(multipart_stream(hub), media_type=media_type, headers={"Cache-Control": "no-store"})

    async def snapshot(_request: Request) -> Response:
        if hub.newest is None:
            return JSONResponse({"detail": "no image yet; the camera is starting, see /healthz"}, status_code=503)
        return Response(hub.newest.jpeg, media_type="image/jpeg", headers=frame_headers(hub.newest))

    async def healthz(_request: Request) -> Response:
        state = health()
        return JSONResponse(state, status_code=200 if state["status"] == "ok" else 503)

    async def fault(request: Request) -> Response:
        if faults is None:
            return JSONResponse({"detail": "faults are not enabled; start the camera with faults"}, status_code=403)
        try:
            faults.kind = _FaultRequest.model_validate_json(await request.body()).kind
        except ValidationError as error:
            kinds = ", ".join(kind.value for kind in FaultKind)
            detail = f"fault: {error.errors()[0]['msg']}; send a JSON object with kind = one of {kinds}"
            return JSONResponse({"detail": detail}, status_code=422)
        return JSONResponse({"kind": faults.kind.value})

    routes = [
        Route("/stream", stream),
        Route("/snapshot.jpg", snapshot),
        Route("/healthz", healthz),
        Route("/fault", fault, methods=["POST"]),
    ]
    return Starlette(routes=routes)
