"""HTTP interface of the simulated camera: multipart stream, snapshot, health, and fault switches if enabled."""

from collections import deque
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from statistics import median
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from sim_plc.camera.faults import FaultKind, FaultSwitch
from sim_plc.camera.frames import Frame, FrameHub

MULTIPART_BOUNDARY = "longreach-frame"


# When to expose and when to hand over: the grid of exposures, the rate it can hold, true time on the PC's clock.

_WINDOW = 15  # pictures over which the work per picture is judged
_LOAD_MAX = 0.85  # share of the period that one picture's work may take
_RAISE_RATIO = 1.2  # the rate rises again only when it may rise by this much


class RateGovernor:
    """Lowers the rate when pictures take too long and raises it again when they do not."""

    def __init__(self, wanted_hz: float) -> None:
        self.wanted_hz = wanted_hz
        self.rate_hz = wanted_hz
        self.busy_s = 0.0  # median work per picture of the last full window
        self._busy_s: deque[float] = deque(maxlen=_WINDOW)

    @property
    def reduced(self) -> bool:
        """Whether the rate is below the wanted one."""
        return self.rate_hz < self.wanted_hz

    def record_busy_time(self, busy_s: float) -> bool:
        """Account for one picture; returns whether the rate has changed."""
        self._busy_s.append(busy_s)
        if len(self._busy_s) < _WINDOW:
            return False
        self.busy_s = median(self._busy_s)
        possible_hz = min(self.wanted_hz, _LOAD_MAX / max(self.busy_s, 1e-6))
        if self.rate_hz <= possible_hz < min(_RAISE_RATIO * self.rate_hz, self.wanted_hz):
            return False
        changed = possible_hz != self.rate_hz
        if changed:
            self.rate_hz = possible_hz
            self._busy_s.clear()
        return changed


@dataclass(slots=True)
class ExposureGrid:
    """Mid-exposure times [ns, true time], evenly spaced; those that cannot be met any more are skipped and counted."""

    t_next_ns: int
    rate_hz: float
    n_skipped: int = 0

    def next_exposure(self, t_now_ns: int) -> int:
        """The next exposure: the earliest on the grid that is not more than one period old."""
        period_ns = round(1e9 / self.rate_hz)
        late = max(0, (t_now_ns - self.t_next_ns) // period_ns)
        self.n_skipped += late
        t_mid_ns = self.t_next_ns + late * period_ns
        self.t_next_ns = t_mid_ns + period_ns
        return t_mid_ns


class TrueClock:
    """True time on this process' monotonic clock, from the newest pose's time; the least delayed reading counts."""

    def __init__(self) -> None:
        self._offset_ns: int | None = None

    def note_pose_time(self, t_true_ns: int, t_mono_ns: int) -> None:
        """The newest pose known at `t_mono_ns` is of `t_true_ns`."""
        offset_ns = t_true_ns - t_mono_ns
        self._offset_ns = offset_ns if self._offset_ns is None else max(self._offset_ns, offset_ns)

    def mono_ns(self, t_true_ns: int) -> int:
        """The monotonic time of a true time. Raises: RuntimeError before the first reading."""
        if self._offset_ns is None:
            raise RuntimeError("true clock: no pose has been seen yet; call saw() first")
        return t_true_ns - self._offset_ns


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
    return f"--{MULTIPART_BOUNDARY}\r\n{lines}\r\n".encode() + frame.jpeg + b"\r\n"


async def multipart_stream(hub: FrameHub) -> AsyncIterator[bytes]:
    """Parts for one client, newest picture only, until the camera shuts down."""
    with hub.subscribe() as subscriber:
        while (frame := await subscriber.next_frame()) is not None:
            yield multipart_part(frame)
    yield f"--{MULTIPART_BOUNDARY}--\r\n".encode()


def camera_app(hub: FrameHub, health: Callable[[], dict[str, Any]], faults: FaultSwitch | None) -> Starlette:
    """The application. `health`: the state, its key "status" is "ok" once pictures flow. `faults` None: refused."""

    async def stream(_request: Request) -> Response:
        media_type = f"multipart/x-mixed-replace; boundary={MULTIPART_BOUNDARY}"
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
