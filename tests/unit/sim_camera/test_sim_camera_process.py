"""The camera as a process of its own: real shared memory, real HTTP."""

import http.client
import itertools
import json
import multiprocessing
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.resources import files
from multiprocessing.process import BaseProcess

import cv2
import numpy as np
import pytest

from benchmarks.simulator.demo_scene import demo_tcp_pose, demo_world
from machine.description import parse_machine_toml
from machine.poses import inverse_pose, pose
from recording.clock import mono_ns
from sim_plc.camera.process import CAMERA_EPOCH_NS, run_camera
from sim_plc.pose_feed import PoseFeed

pytestmark = pytest.mark.system

RATE_HZ = 5.0  # slow enough for a busy machine
START_S = 90.0  # a machine's first run compiles
PLC_EPOCH_NS = 5_000_000_000_000  # true time is this process' monotonic time plus this


@dataclass(frozen=True)
class SmallWorld:
    """What `run_camera` reads of a world."""

    camera: object
    scene: object
    nominal: object
    seed: int


@dataclass
class Running:
    feed: PoseFeed
    process: BaseProcess
    port: int
    T_base_tcp: np.ndarray

    def get(self, path: str, body: dict[str, str] | None = None) -> tuple[int, bytes]:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=5.0)
        try:
            connection.request("GET" if body is None else "POST", path, None if body is None else json.dumps(body))
            response = connection.getresponse()
            return response.status, response.read()
        finally:
            connection.close()

    def publish_until(self, done: Callable[[], bool], timeout_s: float) -> None:
        """Play the PLC process: a pose every millisecond or so."""
        end = time.monotonic() + timeout_s
        checked = 0.0
        while time.monotonic() < end:
            self.feed.publish(mono_ns() + PLC_EPOCH_NS, self.T_base_tcp)
            time.sleep(0.001)
            if time.monotonic() - checked > 0.1:
                checked = time.monotonic()
                if done():
                    return
        raise TimeoutError(f"not done within {timeout_s} s")


@pytest.fixture(scope="module")
def running() -> Iterator[Running]:
    machine = parse_machine_toml(files("machine").joinpath("machines", "hiab033.toml").read_text())
    camera, scene = demo_world(machine)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    feed = PoseFeed.create()
    world = SmallWorld(camera, scene, machine, 3)
    context = multiprocessing.get_context("spawn")
    process = context.Process(target=run_camera, args=(world, feed.feed_name, "127.0.0.1", port, RATE_HZ, 95, True))
    process.start()
    session = Running(feed, process, port, demo_tcp_pose(machine, 0.5))

    def healthy() -> bool:
        try:
            return session.get("/healthz")[0] == 200
        except OSError:
            return False

    try:
        session.publish_until(healthy, START_S)
        yield session
    finally:
        process.terminate()
        process.join(5.0)
        alive = process.is_alive()
        if alive:
            process.kill()
        feed.close()
        assert not alive, "the camera process did not end within 5 s of SIGTERM"


def read_part(stream: http.client.HTTPResponse) -> tuple[dict[str, str], bytes]:
    headers: dict[str, str] = {}
    while line := stream.readline().strip().decode():
        if ":" in line:
            name, value = line.split(": ")
            headers[name] = value
    body = stream.read(int(headers["Content-Length"]))
    stream.readline()
    return headers, body


def test_stream_is_stamped_regularly_and_shows_the_scene(running: Running) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", running.port, timeout=5.0)
    connection.request("GET", "/stream")
    stream = connection.getresponse()
    assert stream.headers["Content-Type"].startswith("multipart/x-mixed-replace; boundary=")
    parts: list[tuple[dict[str, str], bytes]] = []
    ages_s: list[float] = []

    def read_parts() -> None:
        for _ in range(12):
            parts.append(read_part(stream))
            t_camera_ns = mono_ns() + PLC_EPOCH_NS + CAMERA_EPOCH_NS
            ages_s.append(1e-9 * (t_camera_ns - int(parts[-1][0]["X-Exposure-Ns"])))

    reader = threading.Thread(target=read_parts, daemon=True)
    reader.start()
    running.publish_until(lambda: not reader.is_alive(), 20.0)
    connection.close()
    stamps = np.array([int(headers["X-Exposure-Ns"]) for headers, _ in parts])
    periods = np.diff(stamps) * RATE_HZ * 1e-9
    assert np.abs(periods - np.rint(periods)).max() < 1e-6  # on one grid, even where one was left out
    assert np.median(periods) == pytest.approx(1.0)
    sequences = [int(headers["X-Sequence"]) for headers, _ in parts]
    assert all(b > a for a, b in itertools.pairwise(sequences))
    assert min(ages_s) >= 0.040  # s, the latency
    assert np.median(ages_s) < 1.0  # s; no queue, however busy the processor
    picture = cv2.imdecode(np.frombuffer(parts[-1][1], np.uint8), cv2.IMREAD_UNCHANGED)
    assert picture is not None
    assert picture.shape == (720, 2560)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    for half in (picture[:, :1280], picture[:, 1280:]):
        _, ids, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(np.asarray(half, np.uint8))
        assert 10 in ids


def test_health_tells_rates_and_faults_can_be_switched(running: Running) -> None:
    status, body = running.get("/healthz")
    state = json.loads(body)
    assert status == 200
    assert state["rate_hz"] == RATE_HZ
    assert state.keys() >= {"fps", "skipped", "effective_rate_hz", "reduced", "late", "client_skipped"}
    assert running.get("/fault", {"kind": "left_black"})[0] == 200

    def left_is_black() -> bool:
        _, jpeg = running.get("/snapshot.jpg")
        picture = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
        return picture is not None and picture[:, :1270].max() < 8 and picture[:, 1290:].mean() > 50

    running.publish_until(left_is_black, 10.0)
    assert running.get("/fault", {"kind": "none"})[0] == 200


def test_demo_pose_is_the_one_it_says() -> None:
    machine = parse_machine_toml(files("machine").joinpath("machines", "hiab033.toml").read_text())
    T_ooi_tool = demo_tcp_pose(machine, 0.7, (0.1, -0.1)) @ machine.T_tcp_tool
    assert np.allclose(inverse_pose(T_ooi_tool) @ pose(np.eye(3), np.array([0.1, -0.1, 0.7])), np.eye(4), atol=1e-9)
