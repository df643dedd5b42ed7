"""The simulated machine as processes: PLC and plant in real time here, the camera in a child."""

import gc
import logging
import multiprocessing
import os
import secrets
import signal
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import FrameType
from typing import Any, Literal, Self, cast

import numpy as np

from machine.description import parse_machine_toml
from protocol.errors import LocalProtocolError
from protocol.framing import parse_net_id
from recording.clock import mono_ns
from recording.spawn import out_of_the_terminals_reach
from sim_plc.camera.round_marks import MARKS_MAX
from sim_plc.diagnosed import with_effects
from sim_plc.draw_scene import with_bare_rock, with_round_marks, with_structure
from sim_plc.draw_world import draw_world
from sim_plc.machine_loop import MS, MachineLoop, plc_framing
from sim_plc.plc import path
from sim_plc.plc.local_panel import EnableMode, LocalPanel
from sim_plc.plc.servo import Servo
from sim_plc.pose_feed import PoseFeed
from sim_plc.real_time import LoopHealth, RealTimeLoop, UdpPort
from sim_plc.truth_log import TruthLog
from sim_plc.world import World

__all__ = ["SimSettings", "SimSettingsError", "run_sim"]

log = logging.getLogger(__name__)

_WARM_UP_CYCLES = 3
_EPOCH_RANGE_S = 100_000
_HEALTH_NS = 5_000 * MS
_LATE_MS = 250.0  # later than this is logged: the machine visibly stood still
_FIFO_PRIORITY = 20  # below the link process, should both run here
_NICENESS = -10  # where it is allowed: the PLC's cycles before pictures and panels
_CAMERA_STOP_S = 3.0


# What to simulate and where it listens.

FRAMING_CHOICES = ("raw", "eap")
ENABLE_CHOICES = ("auto", "panel")
STRUCTURE_FRAC_MAX = 0.4  # so high are the beams that a camera near the tip sees


class SimSettingsError(ValueError):
    """A setting is out of its bounds; the text names it, its value and the bound."""


@dataclass(frozen=True, slots=True)
class SimSettings:
    """One simulated machine: PLC and stereo camera. `machine_text` is the text of a machine file."""

    machine_text: str
    preset: str = "realistic"
    seed: int = 1
    plc_host: str = "127.0.0.1"
    plc_port: int = 50110  # 0: the system chooses
    framing: str = "raw"
    pc_net_id: str = "192.168.0.10.1.1"  # EAP only
    plc_net_id: str = "192.168.0.20.1.1"
    camera: bool = True
    camera_host: str = "127.0.0.1"
    camera_port: int = 8090
    camera_rate_hz: float = 15.0
    camera_faults: bool = False  # POST /fault at the camera's address is obeyed
    camera_time_code: bool = False  # the exposure's time painted into the left picture, for latency measurements
    structure_frac: float | None = None  # of the picture, covered by the crane itself; None: as the preset draws it
    structure_contrast_frac: float | None = None  # of its texture, 0: plain paint; None: as the preset draws it
    bare_rock: bool = False  # the wall without the object's markers and boards
    round_marks: int = 0  # boreholes and painted rings on that wall
    dry_run: bool = False  # everything is played, but the valves stay neutral
    key: bytes = b""  # 16..64 bytes: take only signed commands, and sign states
    enable: str = "auto"  # or "panel": SIGUSR1 presses and releases the enable, SIGUSR2 the lever, SIGRTMIN the E-stop
    truth_log: Path | None = None
    stand_off_m: float = 0.1  # of the goal that the truth log measures against

    def __post_init__(self) -> None:
        for name, value, choices in (
            ("framing", self.framing, FRAMING_CHOICES),
            ("enable", self.enable, ENABLE_CHOICES),
        ):
            if value not in choices:
                raise SimSettingsError(f"{name} = '{value}': must be one of {', '.join(choices)}")
        for name, port in (("plc_port", self.plc_port), ("camera_port", self.camera_port)):
            if not 0 <= port <= 65535:
                raise SimSettingsError(f"{name} = {port}: must be 0..65535")
        if not 0.1 <= self.camera_rate_hz <= 120.0:
            raise SimSettingsError(f"camera_rate_hz = {self.camera_rate_hz}: must be 0.1..120 Hz")
        for name, share, limit in (
            ("structure_frac", self.structure_frac, STRUCTURE_FRAC_MAX),
            ("structure_contrast_frac", self.structure_contrast_frac, 1.0),
        ):
            if share is not None and not 0.0 <= share <= limit:
                raise SimSettingsError(f"{name} = {share}: must be 0..{limit:g}")
        if not 0 <= self.round_marks <= MARKS_MAX:
            raise SimSettingsError(f"round_marks = {self.round_marks}: must be 0..{MARKS_MAX}")
        if self.seed < 0:
            raise SimSettingsError(f"seed = {self.seed}: must be 0 or more")
        for name, net_id in (("pc_net_id", self.pc_net_id), ("plc_net_id", self.plc_net_id)):
            try:
                parse_net_id(net_id)
            except LocalProtocolError as error:
                raise SimSettingsError(f"{name}: {error}") from error


def run_sim(settings: SimSettings, place: Callable[[World], World] = lambda world: world) -> LoopHealth:
    """Run until SIGTERM or SIGINT; leaves no process and no shared memory behind. Returns how the loop kept up.

    While it prepares (at the first start it compiles for a minute), a signal raises SystemExit.
    `place` may change the drawn world (the OOI elsewhere) before it runs.
    Raises: SimSettingsError (also when the UDP port is taken), PresetError, MachineFileError: nothing was started.
    """
    with _StopFlag() as stopped:
        drawn = draw_world(parse_machine_toml(settings.machine_text), settings.preset, settings.seed)
        shown = with_structure(with_effects(drawn), settings.structure_frac, settings.structure_contrast_frac)
        walled = with_bare_rock(shown) if settings.bare_rock else shown
        world = place(with_round_marks(walled, settings.round_marks))
        panel = LocalPanel(cast(EnableMode, settings.enable))
        _panel_signals(panel)
        return _run(settings, world, panel, stopped)


def _run(settings: SimSettings, world: World, panel: LocalPanel, stopped: "_StopFlag") -> LoopHealth:
    framing = plc_framing(cast(Literal["raw", "eap"], settings.framing), settings.pc_net_id, settings.plc_net_id)
    offset_ns = new_epoch_offset_ns()
    with ExitStack() as cleanup:
        udp = _udp_port(settings)
        cleanup.callback(udp.close)
        _warm_up(world)
        machine = MachineLoop(
            world, framing, _cycle_start(offset_ns), lambda: secrets.randbits(32), panel, settings.key, settings.dry_run
        )
        if settings.truth_log is not None:
            machine.truth = TruthLog(settings.truth_log, world, settings.stand_off_m)
            cleanup.callback(machine.truth.close)
        camera = None
        if settings.camera:  # without a camera the poses have no reader, and cost a sixth of a cycle
            machine.feed = PoseFeed.create(offset_ns)
            cleanup.callback(machine.feed.close)
            camera = _start_camera(world, machine.feed, settings)
            cleanup.callback(_end_camera, camera)
        log.info("PLC ready on udp %s:%d (%s framing)", *udp.address, settings.framing)
        machine.t_plc_ns = _cycle_start(offset_ns)
        loop = RealTimeLoop(machine, udp, offset_ns)
        _run_first()
        gc.freeze()
        stopped.prepared = True
        loop.run(_health_logging_stop_check(stopped, loop.health, camera))
        if loop.health.behind_max_ms > _LATE_MS:
            log.warning("in all: %s", _too_slow(loop.health))
        log.info("simulated machine stopped: %s", loop.health)
        return loop.health


def _run_first() -> None:
    """A PLC is a computer of its own: where it is allowed, its cycles come before everything else here."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(_FIFO_PRIORITY))
    except (OSError, AttributeError):
        with suppress(OSError):
            os.nice(_NICENESS)


def _udp_port(settings: SimSettings) -> UdpPort:
    try:
        return UdpPort(settings.plc_host, settings.plc_port)
    except OSError as error:
        raise SimSettingsError(
            f"plc_host = '{settings.plc_host}', plc_port = {settings.plc_port}: {error.strerror or error}; "
            "choose another, or stop the simulator that is still running"
        ) from error


def new_epoch_offset_ns() -> int:
    """PLC clock minus monotonic clock of one run: the PLC's clock starts where the PC's does not."""
    return secrets.randbelow(_EPOCH_RANGE_S) * 1000 * MS + 1000 * MS


def _cycle_start(offset_ns: int) -> int:
    return (mono_ns() + offset_ns) // MS * MS


def warm_up_all(machine_text: str) -> None:
    """Compile what the plant, the PLC and the camera of a simulated machine call, each preset's effects included."""
    from sim_plc.camera.renderer import StereoRenderer

    for preset in ("ideal", "realistic"):
        world = with_effects(draw_world(parse_machine_toml(machine_text), preset, 1))
        _warm_up(world)
    machine = MachineLoop(world, plc_framing("raw", "", ""), 1000 * MS, lambda: 1)
    Servo(machine.plc.settings).step(np.zeros((3, machine.plc.settings.n)), 1.0, 0)
    StereoRenderer(world).render_static(machine.plant.T_base_tcp())


def _warm_up(world: World) -> None:
    """Compile, or load from the cache, everything the cycle calls, before the clock counts."""
    machine = MachineLoop(world, plc_framing("raw", "", ""), 1000 * MS, lambda: 1)
    for _ in range(_WARM_UP_CYCLES):
        machine.run_cycle()
    path.warm_up(machine.plc.settings.qdd_stop)
    machine.plc.reference.hold_at(machine.plant.q_encoder_rad)
    machine.run_cycle()  # with the controllers on
    machine.plant.T_base_tcp()


def _too_slow(health: LoopHealth) -> str:
    return f"this computer is too slow for real time: {health.behind_max_ms:.0f} ms late, {health.lost_ms} ms let go"


def _health_logging_stop_check(
    stopped: Callable[[], bool], health: LoopHealth, camera: BaseProcess | None
) -> Callable[[], bool]:
    """`stopped`, and on the way a line in the log when the cycles were late or the camera has died."""
    reported, camera_reported, next_ns = (_LATE_MS, 0), False, mono_ns() + _HEALTH_NS

    def asked() -> bool:
        nonlocal reported, camera_reported, next_ns
        if mono_ns() >= next_ns:
            next_ns = mono_ns() + _HEALTH_NS
            now = (health.behind_max_ms, health.lost_ms)
            if now[0] > reported[0] or now[1] > reported[1]:
                reported = now
                log.warning("%s", _too_slow(health))
            if camera is not None and not camera.is_alive() and not camera_reported:
                camera_reported = True
                log.error("the camera process has ended with code %s; the PLC continues without it", camera.exitcode)
        return stopped()

    return asked


class _StopFlag:
    """SIGTERM and SIGINT set it for as long as the block runs. Until all is prepared they also end the block."""

    def __init__(self) -> None:
        self.prepared = self._set = False
        self._before: dict[int, Any] = {}

    def __call__(self) -> bool:
        return self._set

    def __enter__(self) -> Self:
        self._before = {number: signal.signal(number, self._note) for number in (signal.SIGTERM, signal.SIGINT)}
        return self

    def __exit__(self, *_error: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _note(self, number: int, frame: FrameType | None) -> None:
        del frame
        first, self._set = not self._set, True
        if first and not self.prepared:  # once: what is created by then is removed in peace
            raise SystemExit(128 + number)


def _panel_signals(panel: LocalPanel) -> None:
    """Hands at the machine: SIGUSR1 presses and releases the enable, SIGUSR2 the lever, SIGRTMIN the E-stop."""

    def enable(number: int, frame: FrameType | None) -> None:
        del number, frame
        if panel.enabled:
            panel.release_enable()
        else:
            panel.press_enable()

    def lever(number: int, frame: FrameType | None) -> None:
        del number, frame
        panel.lever_taken = not panel.lever_taken

    signal.signal(signal.SIGUSR1, enable)

    def estop(number: int, frame: FrameType | None) -> None:
        del number, frame
        panel.estop_pressed = not panel.estop_pressed

    signal.signal(signal.SIGUSR2, lever)
    signal.signal(signal.SIGRTMIN, estop)


def _start_camera(world: World, feed: PoseFeed, settings: SimSettings) -> BaseProcess:
    from sim_plc.camera.process import run_camera  # only where a camera is wanted: it brings the renderer and uvicorn

    context = multiprocessing.get_context("spawn")
    arguments = (world, feed.feed_name, settings.camera_host, settings.camera_port, settings.camera_rate_hz)
    switches = {"faults": settings.camera_faults, "time_code": settings.camera_time_code}
    camera = context.Process(target=run_camera, args=arguments, kwargs=switches, name="sim-camera", daemon=True)
    with out_of_the_terminals_reach():
        camera.start()
    log.info("camera on http://%s:%d/stream", settings.camera_host, settings.camera_port)
    return camera


def _end_camera(camera: BaseProcess) -> None:
    camera.terminate()
    camera.join(_CAMERA_STOP_S)
    if camera.is_alive():
        camera.kill()
        camera.join(_CAMERA_STOP_S)
