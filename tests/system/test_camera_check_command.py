"""`longreach camera check` on the simulated camera process: real HTTP, real exit codes."""

import json
import multiprocessing
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass, replace

import pytest

from benchmarks.simulator.demo_scene import demo_tcp_pose, demo_world
from longreach.camera_command import camera_settings_of
from machine.description import Machine
from recording.clock import mono_ns
from server.errors import SettingsError
from server.settings import read_machine
from server.settings_camera import DeviceCameraSettings, FolderCameraSettings, HttpCameraSettings, RtspCameraSettings
from sim_plc.camera.process import run_camera
from sim_plc.pose_feed import PoseFeed
from sim_plc.world import CameraTruth, SceneTruth

pytestmark = pytest.mark.system

RATE_HZ = 5.0  # slow enough for a busy machine
MACHINE_BUSY = {"stream", "rate", "loss", "latency"}  # lines that a busy test machine may fail
START_S = 90.0
COMMAND = "from longreach.camera_command import app; app()"


@dataclass(frozen=True)
class SmallWorld:
    """What `run_camera` reads of a world."""

    camera: CameraTruth
    scene: SceneTruth
    nominal: Machine
    seed: int


class Publisher(threading.Thread):
    """Plays the PLC process: the tool at rest, told every few milliseconds."""

    def __init__(self, feed: PoseFeed, T_base_tcp: object) -> None:
        super().__init__(daemon=True)
        self._feed, self._T, self._stop_event = feed, T_base_tcp, threading.Event()

    def run(self) -> None:
        while not self._stop_event.wait(0.004):
            self._feed.publish(mono_ns() + 5_000_000_000_000, self._T)  # type: ignore[arg-type]

    def stop(self) -> None:
        self._stop_event.set()
        self.join(5.0)


@pytest.fixture(scope="module")
def camera_url() -> Iterator[str]:
    machine = read_machine("hiab033")
    camera, scene = demo_world(machine, wall_relief_m=0.05)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    feed = PoseFeed.create()
    publisher = Publisher(feed, demo_tcp_pose(machine, 0.6))
    publisher.start()
    world = SmallWorld(replace(camera), scene, machine, 1)
    process = multiprocessing.get_context("spawn").Process(
        target=run_camera, args=(world, feed.feed_name, "127.0.0.1", port, RATE_HZ, 95, True)
    )
    process.start()
    url = f"http://127.0.0.1:{port}"
    try:
        wait_until_healthy(url)
        yield url
    finally:
        process.terminate()
        process.join(10.0)
        publisher.stop()
        feed.close()


def wait_until_healthy(url: str) -> None:
    end = time.monotonic() + START_S
    while time.monotonic() < end:
        try:
            with urllib.request.urlopen(f"{url}/healthz", timeout=2.0):
                return
        except (urllib.error.URLError, OSError):
            time.sleep(0.2)
    raise TimeoutError(f"camera not healthy within {START_S} s")


def check(*arguments: str) -> tuple[int, dict[str, dict[str, object]]]:
    done = subprocess.run(
        [sys.executable, "-c", COMMAND, "check", "--json", "--seconds", "8", "--pairs", "4", *arguments],
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )
    assert done.stdout, done.stderr
    return done.returncode, {one["name"]: one for one in json.loads(done.stdout)["findings"]}


def test_a_good_camera_passes(camera_url: str) -> None:
    code, found = check("--source", f"{camera_url}/stream")
    rig = ("eyes", "rows", "pitch", "roll", "focal_ratio", "lens", "scale", "sharpness", "exposure")
    failed = {name for name, one in found.items() if one["level"] == "FAIL"}
    assert failed <= MACHINE_BUSY, found
    assert code == (1 if failed else 0)
    assert {name: found[name]["level"] for name in rig} == dict.fromkeys(rig, "OK")
    assert found["tool"]["level"] == found["ooi"]["level"] == "OK"


def test_a_black_eye_fails(camera_url: str) -> None:
    request = urllib.request.Request(
        f"{camera_url}/fault", json.dumps({"kind": "left_black"}).encode(), {"Content-Type": "application/json"}
    )
    clear = urllib.request.Request(
        f"{camera_url}/fault", json.dumps({"kind": "none"}).encode(), {"Content-Type": "application/json"}
    )
    urllib.request.urlopen(request, timeout=5.0).close()
    try:
        code, found = check("--source", f"{camera_url}/stream")
    finally:
        urllib.request.urlopen(clear, timeout=5.0).close()
    assert code == 1
    assert found["exposure"]["level"] == "FAIL"
    assert found["exposure"]["remedy"]


def test_no_camera_fails_with_its_own_words() -> None:
    code, found = check("--source", "http://127.0.0.1:9/stream", "--seconds", "1")
    assert code == 1
    assert "127.0.0.1:9" in str(found["source"]["text"])
    assert found["stream"]["level"] == "FAIL"


def test_words_of_the_command_line_mean_sources() -> None:
    assert camera_settings_of("http://cam/stream") == HttpCameraSettings(url="http://cam/stream")
    assert camera_settings_of("rtsp://cam/x") == RtspCameraSettings(kind="rtsp", url="rtsp://cam/x")
    assert camera_settings_of("2") == DeviceCameraSettings(kind="device", index=2)
    assert camera_settings_of("/dev/v4l/by-id/zed").kind == "device"
    assert camera_settings_of("l/*.png, r/*.png") == FolderCameraSettings(
        kind="folder", left_glob="l/*.png", right_glob="r/*.png"
    )
    with pytest.raises(SettingsError, match="is not an address, device, file or folder"):
        camera_settings_of("nothing.here")
