"""The link process over real UDP against a small PLC in a thread. Bounds are coarse: the machine may be busy."""

import asyncio
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from link_toy_plc import ToyPlc, smooth_knots

from machine.description import Machine, parse_machine_toml
from protocol.codes import PlcState
from protocol.framing import EapFraming, RawFraming
from protocol.limits import limits_of
from protocol.messages import pad_to_eight_axes
from protocol.plc_states import PlcEvent
from recording.clock import mono_ns
from server.errors import JobFailedError
from server.jobs.requests import NextPair
from server.jobs.steering import Steering
from server.link.client import LinkClient
from server.link.contracts import LinkPhase
from server.link.errors import LinkRefusedError, LinkSilentError
from server.link.settings import LinkSettings
from server.motion.contracts import JointTrajectory

pytestmark = [pytest.mark.system, pytest.mark.real_time]
NET_IDS = ("10.0.0.1.1.1", "10.0.0.2.1.1")


@pytest.fixture(scope="module")
def machine() -> Machine:
    text = (Path(__file__).parents[2] / "machine" / "machines" / "hiab033.toml").read_text()
    return parse_machine_toml(text)


class PlcThread:
    """A ToyPlc on a real socket, its own clock an hour ahead."""

    EPOCH_NS = 3_600_000_000_000

    def __init__(self, machine: Machine, framing: str) -> None:
        self.plc = ToyPlc(limits_of(machine.joints), EapFraming.for_plc(*NET_IDS) if framing == "eap" else RawFraming())
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(0.001)
        self.mute = self.done = False
        self.alter: Callable[[bytes], bytes] = bytes
        self.thread = threading.Thread(target=self._run)
        self.thread.start()

    def _run(self) -> None:
        while not self.done:
            try:
                datagram, source = self.socket.recvfrom(2048)
            except TimeoutError:
                datagram, source = b"", None
            t_ns = mono_ns() + self.EPOCH_NS
            if datagram:
                self.plc.receive(self.alter(datagram), t_ns, source)
            for answer, peer in self.plc.cycle(t_ns):
                if not self.mute:
                    self.socket.sendto(self.alter(answer), peer)  # type: ignore[arg-type]

    def close(self) -> None:
        self.done = True
        self.thread.join()
        self.socket.close()


@pytest.fixture(params=["raw", "eap"])
def plc(request: pytest.FixtureRequest, machine: Machine) -> Iterator[PlcThread]:
    thread = PlcThread(machine, request.param)
    thread.framing = request.param  # type: ignore[attr-defined]
    yield thread
    thread.close()


def settings_for(plc: PlcThread) -> LinkSettings:
    return LinkSettings(
        plc_host="127.0.0.1",
        plc_port=plc.socket.getsockname()[1],
        local_host="127.0.0.1",
        framing=plc.framing,  # type: ignore[attr-defined]
        pc_net_id=NET_IDS[0],
        plc_net_id=NET_IDS[1],
    )


def trajectory(joints: int, step_rad: float, duration_s: float, q_start: float = 0.0) -> JointTrajectory:
    knots = smooth_knots(
        pad_to_eight_axes((q_start,) * joints), pad_to_eight_axes((q_start + step_rad,) * joints), duration_s
    )
    arrays = [np.array([getattr(k, name)[:joints] for k in knots]) for name in ("q", "qd", "qdd")]
    return JointTrajectory(np.array([k.t_ns for k in knots]) / 1e9, *arrays)


async def until(condition: Callable[[], bool], timeout_s: float) -> bool:
    end = time.monotonic() + timeout_s
    while not condition() and time.monotonic() < end:  # noqa: ASYNC110 the PLC thread has no asyncio.Event
        await asyncio.sleep(0.01)
    return condition()


async def test_arm_run_cancel_and_disarm(plc: PlcThread, machine: Machine) -> None:
    plc.plc.q_ref = pad_to_eight_axes((0.0, 0.0, -0.5, 0.0, 0.0, 0.0))  # tilt's range does not contain zero
    link = LinkClient(settings_for(plc), machine)
    seen = []
    await link.start()
    try:
        unsubscribe = link.on_sample(seen.append)
        await link.arm(timeout_s=10.0)
        assert link.health.phase is LinkPhase.ARMED
        start = np.array(plc.plc.q_ref[:6])
        path = trajectory(6, 0.05, 1.0)
        path = JointTrajectory(path.t_s, path.q + start, path.qd, path.qdd)

        ended = await link.run(path)
        assert ended.reached, ended.reason
        assert link.latest is not None
        np.testing.assert_allclose(link.latest.q_ref_rad, start + 0.05, atol=1e-12)  # rad
        unsubscribe()

        # clocks: an hour apart, found to 20 ms
        assert link.plc_to_pc_offset_ns is not None
        assert abs(link.plc_to_pc_offset_ns + PlcThread.EPOCH_NS) < 20e6  # ns
        samples = link.samples_since(0)
        assert len(samples) > 50
        assert all(b.t_mono_ns >= a.t_mono_ns for a, b in pairwise(samples))
        assert seen[0] in samples

        # a cancelled run leaves the PLC at rest before the reference's end
        back = JointTrajectory(path.t_s * 3, path.q[::-1].copy(), -path.qd[::-1] / 3, path.qdd[::-1] / 9)
        t_s = np.arange(0, 3.0001, 0.15)
        assert np.allclose(back.t_s, t_s)
        task = asyncio.ensure_future(link.run(back))
        assert await until(lambda: plc.plc.link.state is PlcState.RUN, 3.0)
        await asyncio.sleep(0.3)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert plc.plc.link.state is PlcState.HOLD
        assert plc.plc.t_play_ns < 2.9e9

        # a trajectory that does not start at the reference is refused by our own gate, in words
        ended = await link.run(back)
        assert not ended.reached
        assert "plan from q_ref" in ended.reason

        await link.disarm()
        assert await until(lambda: link.health.phase is LinkPhase.LINKED, 3.0)  # a new session, not armed
        assert link.health.sent > 50
    finally:
        await link.close()


@pytest.fixture
def raw_plc(machine: Machine) -> Iterator[PlcThread]:
    thread = PlcThread(machine, "raw")
    thread.framing = "raw"  # type: ignore[attr-defined]
    thread.plc.q_ref = pad_to_eight_axes((0.0, 0.0, -0.5, 0.0, 0.0, 0.0))
    yield thread
    thread.close()


def long_path(plc: PlcThread) -> JointTrajectory:
    path = trajectory(6, 0.4, 20.0)
    return JointTrajectory(path.t_s, path.q + np.array(plc.plc.q_ref[:6]), path.qd, path.qdd)


async def test_killed_link_process_ends_the_motion_and_is_replaced(raw_plc: PlcThread, machine: Machine) -> None:
    link = LinkClient(settings_for(raw_plc), machine)
    await link.start()
    try:
        await link.arm(timeout_s=10.0)
        task = asyncio.ensure_future(link.run(long_path(raw_plc)))
        assert await until(lambda: raw_plc.plc.link.state is PlcState.RUN, 3.0)
        killed = link.process_id
        assert killed is not None
        os.kill(killed, signal.SIGKILL)
        ended = await asyncio.wait_for(task, 5.0)
        assert not ended.reached
        assert "link process died" in ended.reason
        assert await until(lambda: raw_plc.plc.link.state is not PlcState.RUN, 1.0)
        assert await until(lambda: link.health.phase is LinkPhase.LINKED, 15.0)  # restarted, linked, not armed
        assert link.process_id != killed
        await link.arm(timeout_s=5.0)  # motion needs ARM again
    finally:
        await link.close()


@pytest.mark.parametrize(
    ("proof", "word"), [("hold_until", "hold-to-run"), ("steer_until", "no stereo pair was evaluated")]
)
async def test_a_proof_that_nobody_renews_stops_the_motion_without_the_server(
    raw_plc: PlcThread, machine: Machine, proof: str, word: str
) -> None:
    """The server's loop is blocked, as by a busy computer; the link process ends the motion by itself."""
    link = LinkClient(settings_for(raw_plc), machine)
    renew = getattr(link, proof)
    await link.start()
    try:
        await link.arm(timeout_s=10.0)
        await renew(mono_ns() + 2_000_000_000)
        task = asyncio.ensure_future(link.run(long_path(raw_plc)))
        assert await until(lambda: raw_plc.plc.link.state is PlcState.RUN, 1.5)
        await renew(mono_ns() + 280_000_000)
        time.sleep(1.5)  # noqa: ASYNC251 this is the blocked loop
        accepted = [e.command.mode.name for e in raw_plc.plc.events if hasattr(e, "command")]
        assert "STOP" in accepted
        assert raw_plc.plc.link.state is not PlcState.RUN
        ended = await asyncio.wait_for(task, 3.0)
        assert not ended.reached
        assert word in ended.reason
        with pytest.raises(LinkRefusedError, match=word):  # the rest of a job must not begin after it
            await link.run(long_path(raw_plc))
        await renew(None)
        task = asyncio.ensure_future(link.run(long_path(raw_plc)))
        assert await until(lambda: raw_plc.plc.link.state is PlcState.RUN, 3.0)
        await link.stop("test")
        await task
    finally:
        await link.close()


class Camera:
    """Tells a good pair whenever the test says so, exposed at the newest sample: a busy machine has gaps."""

    def __init__(self, link: LinkClient) -> None:
        self.link = link

    def on_report(self, callback: Callable[[object], None]) -> None:
        self.tell = callback

    def pair(self) -> None:
        seen = SimpleNamespace(tool=None, ooi=None)
        exposed_ns = self.link.latest.t_plc_ns + self.link.plc_to_pc_offset_ns  # type: ignore[union-attr, operator]
        self.tell(SimpleNamespace(t_exposure_mapped_ns=exposed_ns, warnings=(), observation=seen))


async def test_a_steered_motion_goes_on_by_its_pairs_and_not_past_a_stall(raw_plc: PlcThread, machine: Machine) -> None:
    link = LinkClient(settings_for(raw_plc), machine)
    camera = Camera(link)
    steering = Steering(SimpleNamespace(link=link, vision=camera))  # type: ignore[arg-type]
    await link.start()
    try:
        await link.arm(timeout_s=10.0)
        await steering.start(long_path(raw_plc))
        number, until_s = 0, time.monotonic() + 1.5  # more than one silence: the pairs carry it
        while time.monotonic() < until_s:
            camera.pair()
            seen = await steering.next_pair(NextPair(number, 0.6, 0.0))
            assert (seen.fault, seen.motion_ended) == ("", False)
            number = seen.number
            await asyncio.sleep(0.05)
        assert raw_plc.plc.link.state is PlcState.RUN
        time.sleep(1.5)  # noqa: ASYNC251 the server is busy with something else
        assert raw_plc.plc.link.state is not PlcState.RUN
        with pytest.raises(JobFailedError, match="no stereo pair was evaluated in time"):
            await asyncio.wait_for(steering.wait_for_end(), 3.0)
        task = asyncio.ensure_future(link.run(long_path(raw_plc)))  # the next job is not held to it
        assert await until(lambda: raw_plc.plc.link.state is PlcState.RUN, 3.0)
        await link.stop("test")
        await task
    finally:
        await link.close()


async def test_terminated_link_process_sends_a_stop(raw_plc: PlcThread, machine: Machine) -> None:
    link = LinkClient(settings_for(raw_plc), machine)
    await link.start()
    await link.arm(timeout_s=10.0)
    task = asyncio.ensure_future(link.run(long_path(raw_plc)))
    assert await until(lambda: raw_plc.plc.link.state is PlcState.RUN, 3.0)
    await link.close()
    ended = await asyncio.wait_for(task, 3.0)
    assert not ended.reached
    stops = [e for e in raw_plc.plc.events if getattr(e, "event", None) is PlcEvent.SOFT_STOP]
    assert stops
    accepted = [e.command.mode.name for e in raw_plc.plc.events if hasattr(e, "command")]
    assert "STOP" in accepted  # stopped by word, not by silence


async def test_silent_plc_is_told_in_words(machine: Machine) -> None:
    link = LinkClient(LinkSettings(plc_host="127.0.0.1", plc_port=9, local_host="127.0.0.1"), machine)
    await link.start()
    try:
        assert link.health.phase is LinkPhase.OFFLINE
        with pytest.raises(LinkSilentError, match=r"PLC silent: no state from 127\.0\.0\.1:9"):
            await link.arm(timeout_s=0.5)
    finally:
        await link.close()


async def test_missing_enable_is_told_in_words(raw_plc: PlcThread, machine: Machine) -> None:
    raw_plc.plc.enable = False
    link = LinkClient(settings_for(raw_plc), machine)
    await link.start()
    try:
        with pytest.raises(LinkRefusedError, match="local enable missing"):
            await link.arm(timeout_s=2.5)
        raw_plc.plc.enable = True
        await asyncio.sleep(1.0)
        assert raw_plc.plc.link.state is not PlcState.HOLD  # given up means given up
    finally:
        await link.close()


async def test_plc_that_falls_silent_ends_the_motion(raw_plc: PlcThread, machine: Machine) -> None:
    link = LinkClient(settings_for(raw_plc), machine)
    await link.start()
    try:
        await link.arm(timeout_s=10.0)
        task = asyncio.ensure_future(link.run(long_path(raw_plc)))
        assert await until(lambda: raw_plc.plc.link.state is PlcState.RUN, 3.0)
        raw_plc.mute = True
        ended = await asyncio.wait_for(task, 5.0)
        assert not ended.reached
        assert "no state from the PLC" in ended.reason
        assert raw_plc.plc.link.state is not PlcState.RUN
    finally:
        await link.close()


SERVER = """
import asyncio, sys
import numpy as np
from pathlib import Path
from machine.description import parse_machine_toml
from server.link.client import LinkClient
from server.link.settings import LinkSettings
from server.motion.contracts import JointTrajectory

async def main():
    machine = parse_machine_toml(Path(sys.argv[1]).read_text())
    link = LinkClient(LinkSettings(plc_host="127.0.0.1", plc_port=int(sys.argv[2]), local_host="127.0.0.1"), machine)
    await link.start()
    await link.arm(10.0)
    print(link.process_id, flush=True)
    await link.run(JointTrajectory(*np.load(sys.argv[3]).values()))

if __name__ == "__main__":
    asyncio.run(main())
"""


def test_killed_server_takes_the_link_process_with_it_and_the_machine_stops(raw_plc: PlcThread, tmp_path: Path) -> None:
    script, path_file = tmp_path / "server_to_kill.py", tmp_path / "path.npz"
    script.write_text(SERVER)
    path = long_path(raw_plc)
    np.savez(path_file, path.t_s, path.q, path.qd, path.qdd)
    toml = Path(__file__).parents[2] / "machine" / "machines" / "hiab033.toml"
    port = str(raw_plc.socket.getsockname()[1])
    with subprocess.Popen(
        [sys.executable, str(script), str(toml), port, str(path_file)], stdout=subprocess.PIPE
    ) as server:
        assert server.stdout is not None
        link_pid = int(server.stdout.readline())
        wait_for(lambda: raw_plc.plc.link.state is PlcState.RUN, 5.0)
        server.send_signal(signal.SIGKILL)
        wait_for(lambda: raw_plc.plc.link.state is not PlcState.RUN, 0.5)
        wait_for(lambda: not Path(f"/proc/{link_pid}").exists() or "Z" in process_state(link_pid), 3.0)
        wait_for(lambda: raw_plc.plc.link.state is PlcState.DISARMED, 3.0)


def wait_for(condition: Callable[[], bool], timeout_s: float) -> None:
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, "not in time"
        time.sleep(0.005)


def process_state(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return "Z"
