"""The simulated machine as processes: PLC and plant in real time here, the camera in a child."""

import logging
import multiprocessing
import signal
import socket
import time
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import FrameType

from machine.description import parse_machine_toml
from protocol.codes import PlcState
from sim_plc.draw_world import draw_world
from sim_plc.machine_loop import MachineLoop, framing_of
from sim_plc.pose_feed import PoseFeed
from sim_plc.truth_log import TruthLog
from sim_plc.world import World

log = logging.getLogger(__name__)

STATE_PERIOD_NS = 10_000_000
WAKE_S = 0.002
BATCH_NS = 20_000_000  # at most this much is caught up before the socket is looked at again
RECEIVE_BATCH = 64
PLC_EPOCH_NS = 7_000_000_000_000  # the PLC's clock does not start where the PC's does


@dataclass(frozen=True, slots=True)
class SimSettings:
    """What to simulate and where it listens."""

    machine_text: str
    preset: str = "realistic"
    seed: int = 1
    plc_host: str = "127.0.0.1"
    plc_port: int = 50110
    framing: str = "raw"
    camera: bool = True
    camera_host: str = "127.0.0.1"
    camera_port: int = 8090
    camera_rate_hz: float = 15.0
    local_enable: bool = True
    truth_log: Path | None = None


class _Stop(Exception):  # noqa: N818 -- a request, not an error
    """SIGTERM or SIGINT arrived."""


def run_sim(settings: SimSettings) -> None:
    """Run until SIGTERM or SIGINT; leaves no process and no shared memory behind."""
    world = draw_world(parse_machine_toml(settings.machine_text), settings.preset, settings.seed)
    _stop_on_signals()
    feed = PoseFeed.create()
    camera: BaseProcess | None = None
    truth = TruthLog(settings.truth_log, world) if settings.truth_log is not None else None
    try:
        camera = _start_camera(world, feed, settings) if settings.camera else None
        _real_time(world, settings, feed, truth)
    except _Stop:
        log.info("stopping")
    finally:
        if camera is not None:
            camera.terminate()
            camera.join(3.0)
            if camera.is_alive():
                camera.kill()
        if truth is not None:
            truth.close()
        feed.close()


def _stop_on_signals() -> None:
    def stop(_number: int, _frame: FrameType | None) -> None:
        raise _Stop

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)


def _start_camera(world: World, feed: PoseFeed, settings: SimSettings) -> BaseProcess:
    from sim_plc.camera.process import run_camera

    context = multiprocessing.get_context("spawn")
    arguments = (world, feed.name, settings.camera_host, settings.camera_port, settings.camera_rate_hz)
    camera = context.Process(target=run_camera, args=arguments, name="sim-camera", daemon=True)
    camera.start()
    return camera


def _real_time(world: World, settings: SimSettings, feed: PoseFeed, truth: TruthLog | None) -> None:
    loop = MachineLoop(world, framing_of(settings.framing), plc_now_ns(), local_enable=settings.local_enable)
    loop.cycle()  # compiles the plant before the clock counts
    loop.t_plc_ns = plc_now_ns()
    loop.feed, loop.truth = feed, truth
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.bind((settings.plc_host, settings.plc_port))
        udp.setblocking(False)
        log.info("PLC listens on udp %s:%d", settings.plc_host, settings.plc_port)
        next_state_ns = 0
        while True:
            _drain(udp, loop)
            now_ns = plc_now_ns()
            loop.advance_to(min(now_ns, loop.t_plc_ns + BATCH_NS))
            if loop.t_plc_ns >= next_state_ns:
                next_state_ns = max(next_state_ns + STATE_PERIOD_NS, loop.t_plc_ns)
                _send_state(udp, loop)
            if now_ns - loop.t_plc_ns < BATCH_NS:
                time.sleep(WAKE_S)


def plc_now_ns() -> int:
    """The PLC's clock."""
    return time.monotonic_ns() + PLC_EPOCH_NS


def _drain(udp: socket.socket, loop: MachineLoop) -> None:
    for _ in range(RECEIVE_BATCH):
        try:
            datagram, source = udp.recvfrom(4096)
        except (BlockingIOError, ConnectionRefusedError):
            return
        loop.plc.receive(datagram, loop.t_plc_ns, source)


def _send_state(udp: socket.socket, loop: MachineLoop) -> None:
    peer = loop.plc.link.peer
    if peer is not None and loop.plc.state is not PlcState.BOOT:
        with suppress(BlockingIOError, ConnectionRefusedError):
            udp.sendto(loop.plc.send(loop.t_plc_ns), peer)  # type: ignore[arg-type]
