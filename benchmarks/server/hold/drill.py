"""One press after another in a real browser, each ended in one of five ways while the machine moves."""

import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.kills.plc_process import PlcProcess, free_udp_port
from benchmarks.kills.relay import Relay
from benchmarks.kills.under_test import START_S, ServerUnderTest
from benchmarks.server.hold.network import Network
from longreach.fleet_client import JobClient
from protocol.codes import PlcState
from recording.clock import mono_ns
from server.settings import read_machine_text
from sim_plc.process import SimSettings

JOG_AXES = ("joint_1", "x", "joint_2", "y", "joint_3", "z", "joint_4", "rx", "joint_5", "ry", "joint_6", "rz")
WAYS = ("release", "blur", "closed tab", "pulled network", "300 ms stall")
JOG_WAYS = WAYS[:4]
LIMIT_MS = {"release": 100.0, "blur": 100.0, "closed tab": 100.0, "pulled network": 350.0, "300 ms stall": 350.0}
STALL_S = 0.3
CLOCK_TRIES = 25
WITNESS = """for (const name of ["pointerup", "blur"]) addEventListener(name, (event) => {
  if (event.target === window || name === "pointerup") window.letGoAt = performance.now();
}, true);"""


@dataclass(frozen=True, slots=True)
class HoldCase:
    """One press: from the event to the first PLC state that shows the ramp, as it arrived here [ms]."""

    way: str
    number: int
    delay_ms: float
    clock_error_ms: float
    moved_again: bool  # after the ramp, without another press
    reason: str


class StampedRelay(Relay):
    """Keeps when each state arrived."""

    def __init__(self, plc_port: int) -> None:
        super().__init__(plc_port)
        self.stamps: list[int] = []

    def _from_plc(self) -> None:
        super()._from_plc()
        del self.stamps[len(self.states) :]
        self.stamps += [mono_ns()] * (len(self.states) - len(self.stamps))


class HoldDrill:
    """PLC, server and browser; `case` does one press. A context manager that leaves nothing behind."""

    def __init__(self, folder: Path, browser: Any) -> None:
        self._folder, self._browser = folder, browser
        self._page: Any = None
        self._presses = 0

    def __enter__(self) -> "HoldDrill":
        self._folder.mkdir(parents=True, exist_ok=True)
        machine = (self._folder / "machine.toml").resolve()
        machine.write_text(read_machine_text("hiab033"), encoding="utf-8")
        settings = SimSettings(machine.read_text("utf-8"), seed=1, plc_port=free_udp_port(), camera=False)
        with ExitStack() as ending:  # whatever of it fails, what has been started is ended
            plc = PlcProcess(settings).__enter__()
            ending.callback(plc.end)
            self._relay = StampedRelay(settings.plc_port).__enter__()
            ending.callback(self._relay.close)
            self._server = ServerUnderTest(self._relay.port, machine, self._folder)
            ending.callback(self._server.close)
            self._server.start()
            self._relay.wait(lambda state: state.plc_state is PlcState.LINKED, START_S, "the link")
            with JobClient(f"http://127.0.0.1:{self._server.http_port}") as client:
                _wait_for_numerics(client)
                client.run({"kind": "look"})  # it shows nothing, and so no wall: the page may park
            self._network = ending.enter_context(Network(self._server.http_port))
            ending.callback(self._close_page)
            self._ending = ending.pop_all()
        return self

    def __exit__(self, *error: object) -> None:
        self._ending.close()

    def _close_page(self) -> None:
        if self._page is not None:
            self._page.context.close()
            self._page = None

    def case(self, way: str, number: int, seed: int) -> HoldCase:
        """Press, wait for a moment of the move drawn from the seed, let go in that way, watch for a second.

        Raises: TimeoutError: the machine did not begin to move, or never ramped.
        """
        rng = np.random.default_rng([seed, WAYS.index(way), number])
        page = self._opened()
        offset_ns, error_ms = _clock_of(page)
        button = self._next_button(page)
        button.wait_for(timeout=20_000)
        button.scroll_into_view_if_needed()
        box = button.bounding_box()
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        page.mouse.down()
        self._relay.wait(lambda state: state.plc_state is PlcState.RUN, 20.0, "the motion while held")
        time.sleep(float(rng.uniform(0.4, 1.0)))
        begin = len(self._relay.states)
        t_event_ns = self._let_go(way, page, offset_ns)
        t_ramp_ns = self._ramp_since(begin)
        time.sleep(1.0)
        moved_again = self._relay.states[-1].plc_state is PlcState.RUN
        reason = self._after(way, page)
        return HoldCase(way, number, (t_ramp_ns - t_event_ns) * 1e-6, error_ms, moved_again, reason)

    def _opened(self) -> Any:
        """The page, in control, with the hold switch on."""
        if self._page is not None and not self._page.is_closed():
            return self._page
        context = self._browser.new_context(viewport={"width": 1280, "height": 900})
        page = self._page = context.new_page()
        page.add_init_script(WITNESS)
        page.goto(f"http://127.0.0.1:{self._network.port}/?no3d")
        page.locator("#control-buttons button").last.click(timeout=20_000)
        page.wait_for_function("() => document.getElementById('control').classList.contains('mine')", timeout=20_000)
        self._prepare(page)
        return page

    def _prepare(self, page: Any) -> None:
        """The hold switch on: every step of the simulated machine is held."""
        page.locator("details.options summary").click()
        page.locator("#hold-switch").check()

    def forget_page(self) -> None:
        """After a case that went wrong: begin with a new page."""
        self._network.plug_in()
        self._close_page()

    def told(self) -> str:
        """What the page says of its buttons, on one line."""
        if self._page is None or self._page.is_closed():
            return ""
        buttons = self._page.locator("button[data-kind], #jog-why, #notice").all_inner_texts()
        return " | ".join(text.replace("\n", ": ") for text in buttons)

    def _next_button(self, page: Any) -> Any:
        """Away from the parked pose and back again: the machine stays where there is room."""
        self._presses += 1
        return page.locator(f"button[data-kind={'retract' if self._presses % 2 else 'park'}]:enabled")

    def _let_go(self, way: str, page: Any, offset_ns: int) -> int:
        """The moment of the event [mono ns]."""
        match way:
            case "release":
                page.mouse.up()
                return int(page.evaluate("() => window.letGoAt") * 1e6) + offset_ns
            case "blur":
                page.evaluate("() => { window.dispatchEvent(new Event('blur')); }")
                return int(page.evaluate("() => window.letGoAt") * 1e6) + offset_ns
            case "closed tab":
                t_ns = mono_ns()
                page.close(run_before_unload=True)  # as by a hand: without it the page is told much later
                return t_ns
            case "pulled network":
                return self._network.pull()
        t_ns = self._network.pull()
        time.sleep(STALL_S)
        self._network.plug_in()
        return t_ns

    def _ramp_since(self, begin: int) -> int:
        deadline = time.monotonic() + 5.0
        while time.monotonic() < deadline:
            for i in range(begin, len(self._relay.stamps)):
                if self._relay.states[i].plc_state is PlcState.STOPPING:
                    return self._relay.stamps[i]
            time.sleep(0.002)
        raise TimeoutError(f"no ramp within 5 s; the PLC says {self._relay.states[-1].plc_state.name}")

    def _after(self, way: str, page: Any) -> str:
        """Bring everything back for the next press; why the job ended."""
        self._network.plug_in()
        if way == "closed tab":
            page.context.close()
            self._page = None
        else:
            page.mouse.up()
        deadline = time.monotonic() + 10.0
        while (job := self._server.newest_job())["state"] in ("running", "stopping") and time.monotonic() < deadline:
            time.sleep(0.05)
        return str(job["reason"])


class JogDrill(HoldDrill):
    """The same with the jog buttons: one axis after another, each there and back."""

    def _prepare(self, page: Any) -> None:
        """A jog is always held."""

    def _next_button(self, page: Any) -> Any:
        number, back = divmod(self._presses, 2)
        self._presses += 1
        page.locator("#jog-axis:enabled").select_option(JOG_AXES[number % len(JOG_AXES)], timeout=20_000)
        return page.locator(f"#jog-buttons button[data-jog='{-1 if back else 1}']:enabled")


def _wait_for_numerics(client: JobClient) -> None:
    """Until a look may begin. Raises: TimeoutError: why it may not."""
    deadline = time.monotonic() + START_S
    while why := client.state()["steps"]["look"]:
        if time.monotonic() > deadline:
            raise TimeoutError(f"no job after {START_S:.0f} s: {why}")
        time.sleep(0.5)


def _clock_of(page: Any) -> tuple[int, float]:
    """What to add to performance.now() for our monotonic clock [ns], and half the shortest round trip [ms]."""
    best = (2**63, 0)
    for _ in range(CLOCK_TRIES):
        before = mono_ns()
        told_ms = page.evaluate("() => performance.now()")
        after = mono_ns()
        best = min(best, (after - before, (after + before) // 2 - int(told_ms * 1e6)))
    return best[1], best[0] * 0.5e-6
