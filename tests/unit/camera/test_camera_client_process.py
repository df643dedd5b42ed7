"""The vision process and its client, with a stand-in camera: starting, silence, death, end."""

import asyncio
import os
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import cv2
import numpy as np
import psutil
import pytest
from camera_stand_in import CameraStandIn, jpeg_of, part_of

from machine.description import parse_machine_toml
from recording.clock import mono_ns
from server.camera.client import VisionClient
from server.camera.contracts import VisionSettings
from server.camera.health.stamps import STARTING_PAIRS
from server.camera.sources.settings import HttpSource
from server.vision.contracts import LookStatus

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[3]
MACHINE = parse_machine_toml((ROOT / "machine" / "machines" / "hiab033.toml").read_text(encoding="utf-8"))
STARTED_S = 240.0


def bodies(count: int) -> list[bytes]:
    rng = np.random.default_rng(3)
    coarse = rng.integers(60, 200, (9, 32)).astype(np.uint8)
    wall = cv2.resize(coarse, (2560, 720), interpolation=cv2.INTER_CUBIC).astype(np.int16)
    noisy = [np.clip(wall + rng.integers(-3, 4, wall.shape), 0, 255).astype(np.uint8) for _ in range(count)]
    return [jpeg_of(picture) for picture in noisy]


@asynccontextmanager
async def running_client(url: str) -> AsyncIterator[VisionClient]:
    client = VisionClient(VisionSettings(HttpSource(url), threads=1), MACHINE)
    await client.start()
    try:
        yield client
    finally:
        await client.close()


async def until(condition: Callable[[], bool], timeout_s: float = STARTED_S) -> None:
    async with asyncio.timeout(timeout_s):
        while not condition():  # noqa: ASYNC110 what is waited for lies in another process
            await asyncio.sleep(0.02)


async def feed(camera: CameraStandIn, pictures: list[bytes], stop: asyncio.Event) -> None:
    number = 0
    while not stop.is_set():
        number += 1
        part = part_of(pictures[number % len(pictures)], mono_ns() - 10**12, number)
        await asyncio.to_thread(camera.send, part)
        await asyncio.sleep(0.1)


async def test_reports_look_death_and_restart() -> None:
    stop = asyncio.Event()
    with CameraStandIn() as camera:
        async with running_client(camera.url) as client:
            feeding = asyncio.create_task(feed(camera, bodies(4), stop))
            seen: list[int] = []
            client.on_report(lambda report: seen.append(report.sequence))
            await until(lambda: len(seen) > STARTING_PAIRS)
            report = client.latest
            assert report is not None
            assert report.fit_for_look, report.warnings
            assert abs(report.t_exposure_mapped_ns - report.t_receive_mono_ns) < 1e9
            assert client.latest_preview is not None
            assert client.latest_preview[0][:2] == b"\xff\xd8"
            look = await client.look(3, 10.0, 1.0)
            assert look.status is LookStatus.TOOL_NOT_SEEN
            await client.set_pose_source("mono")
            await until(lambda: client.latest is not None and client.latest.pose_source == "mono")
            first = client.process_id
            assert first is not None
            os.kill(first, signal.SIGKILL)
            camera.hang_up()
            await until(lambda: client.restarts == 1)
            assert "exit code -9" in client.stream_text
            count = len(seen)
            feeding.cancel()
            await asyncio.gather(feeding, return_exceptions=True)
            feeding = asyncio.create_task(feed(camera, bodies(4), stop))
            await until(lambda: len(seen) > count + 2)
            assert client.process_id != first
            assert client.latest.pose_source == "mono"  # as asked for, of the process before
            stop.set()
            await feeding
        assert client.process_id is None


async def test_a_silent_camera_gives_no_images() -> None:
    async with running_client("http://127.0.0.1:9/stream") as client:
        await until(lambda: "refused" in client.stream_text)
        look = await client.look(3, 0.3, 1.0)
    assert look.status is LookStatus.NO_IMAGES
    assert "refused" in look.reason


async def test_a_process_that_hangs_is_ended_and_another_one_started(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("server.camera.client.SILENT_HEARTBEATS_MAX", 3)
    async with running_client("http://127.0.0.1:9/stream") as client:
        await until(lambda: "refused" in client.stream_text)
        first = client.process_id
        assert first is not None
        await asyncio.sleep(5.0)  # a camera that is off is no process that hangs
        assert (client.process_id, client.restarts) == (first, 0)
        os.kill(first, signal.SIGSTOP)
        await until(lambda: client.restarts == 1, 30.0)
        await until(lambda: client.process_id not in (None, first), 30.0)


def test_the_process_ends_with_its_parent() -> None:
    code = f"""
import asyncio, sys
sys.path.insert(0, {str(ROOT)!r})
from machine.description import parse_machine_toml
from server.camera.client import VisionClient
from server.camera.contracts import VisionSettings
from server.camera.sources.settings import HttpSource
async def main():
    machine = parse_machine_toml(open({str(ROOT / "machine/machines/hiab033.toml")!r}).read())
    client = VisionClient(VisionSettings(HttpSource("http://127.0.0.1:9/stream")), machine)
    await client.start()
    while "refused" not in client.stream_text:
        await asyncio.sleep(0.05)
    print(client.process_id, flush=True)
    await asyncio.sleep(60.0)
if __name__ == "__main__":
    asyncio.run(main())
"""
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
    assert parent.stdout is not None
    child = psutil.Process(int(parent.stdout.readline()))
    parent.kill()
    parent.wait()
    parent.stdout.close()
    child.wait(timeout=10.0)
