"""The live stream, read by a WebSocket client of its own protocol; one that stalls costs nothing."""

import asyncio
import importlib.util
import json
import os
import socket
import struct
import subprocess
import sys
import time
from base64 import b64decode
from types import SimpleNamespace

import pytest
import websockets
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from served import bench

from machine.urdf import urdf_text
from recording.clock import mono_ns
from server.errors import SettingsError
from server.faces import shell
from server.faces.foxglove import VIEWER_BACKLOG_MESSAGES_MAX, FoxgloveFace, check_foxglove, foxglove_face
from server.jobs.engine import Job, JobEvent
from server.jobs.records import ErrorMm
from server.link.contracts import PlcSample
from server.settings import FoxgloveSettings

needs_sdk = pytest.mark.skipif(importlib.util.find_spec("foxglove") is None, reason="foxglove-sdk is not installed")
Q = (0.1, -0.2, 0.3, -0.4, 0.5, -0.6)
ERROR = ErrorMm(1, 2, 300, 4, 0.7, 0.7, 0.7, 0.2, 300, 0, 0, 400)
PROTOCOL = "foxglove.sdk.v1"
MESSAGE_DATA = 1  # operation code: subscription (4 bytes), log time (8 bytes), data
IMAGE_BYTES = 150_000
KINDS = {
    "/joint_states": JointStates,
    "/tf": FrameTransforms,
    "/camera/left": CompressedImage,
    "/log": Log,
}


def sample(t_mono_ns, q=Q):
    zeros = (0.0,) * 6
    return PlcSample(
        1, t_mono_ns, 1, q, zeros, q, zeros, zeros, zeros, zeros, 2.1e7, 40.0, "RUN", 0, 0, 0, 0, 0, 0, 0, True
    )


@pytest.fixture
def service(tmp_path):
    made = bench(tmp_path)
    made.service.cell.link.latest = sample(mono_ns())
    made.service.cell.vision.latest_preview = (b"\xff\xd8" + bytes(IMAGE_BYTES), mono_ns())
    made.service.cell.knowledge.last_look = SimpleNamespace(error=ERROR)
    yield made.service
    made.keeper.database.close()


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Viewer:
    """Subscribes to every channel that is advertised; `take` gives topic and data of one message."""

    def __init__(self, port):
        self._url = f"ws://127.0.0.1:{port}"
        self.channels, self._topics = {}, {}

    async def __aenter__(self):
        self._socket = await websockets.connect(self._url, subprotocols=[PROTOCOL], max_size=None)
        assert self._socket.subprotocol == PROTOCOL
        return self

    async def __aexit__(self, *_error):
        await self._socket.close()

    async def take(self):
        while True:
            heard = await self._socket.recv()
            if isinstance(heard, str):
                await self._text(json.loads(heard))
            elif heard[0] == MESSAGE_DATA:
                number, _ = struct.unpack_from("<IQ", heard, 1)
                return self._topics[number], heard[13:]

    async def _text(self, told):
        if told["op"] != "advertise":
            return
        wanted = []
        for channel in told["channels"]:
            self.channels[channel["topic"]] = channel
            self._topics[channel["id"]] = channel["topic"]
            wanted.append({"id": channel["id"], "channelId": channel["id"]})
        await self._socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))


async def seen(viewer, topics, newer=lambda: None):
    """The first message of each topic, while the machine goes on."""
    found = {}
    going_on = asyncio.create_task(again_and_again(newer))
    try:
        async with asyncio.timeout(60.0):
            while set(topics) - set(found):
                topic, data = await viewer.take()
                found.setdefault(topic, data)
    finally:
        going_on.cancel()
    return found


async def again_and_again(newer):
    while True:
        newer()
        await asyncio.sleep(0.05)


@needs_sdk
async def test_robot_joints_frames_image_errors_and_log_are_read(service):
    settings = FoxgloveSettings(enabled=True, port=free_port())
    async with foxglove_face(service, settings) as face, Viewer(face.port) as viewer:

        def newer():
            service.cell.link.latest = sample(mono_ns())
            service.cell.vision.latest_preview = (b"\xff\xd8" + bytes(IMAGE_BYTES), mono_ns())
            face.note(Job("1", "look", "anna"), JobEvent(1, 0.0, "look", 0.0, 1.0, "", "look 1"))

        found = await seen(viewer, [*KINDS, "/robot_description", "/tool_error"], newer)
    read = {topic: kind.FromString(found[topic]) for topic, kind in KINDS.items()}
    assert [joint.position for joint in read["/joint_states"].joints] == list(Q)
    names = [joint.name for joint in read["/joint_states"].joints]
    assert names == [joint.name for joint in service.cell.machine.joints]
    edges = {(edge.parent_frame_id, edge.child_frame_id) for edge in read["/tf"].transforms}
    assert {("base", "link_1"), ("link_6", "tcp"), ("tcp", "cam_left")} <= edges
    assert read["/camera/left"].format == "jpeg"
    assert len(read["/camera/left"].data) == IMAGE_BYTES + 2
    assert read["/log"].message == "look: look 1"
    description = json.loads(found["/robot_description"])["data"]
    assert description == urdf_text(service.cell.machine)
    assert all(f'<joint name="{name}"' in description for name in names)
    assert json.loads(found["/tool_error"])["z_mm"] == 300
    assert viewer.channels["/robot_description"]["schemaName"] == "std_msgs/String"
    described = FileDescriptorSet.FromString(b64decode(viewer.channels["/tf"]["schema"]))
    assert any("FrameTransforms" in file.name for file in described.file)


@needs_sdk
async def test_a_viewer_that_stalls_costs_nothing_and_the_other_sees_the_present(service):
    """4,000 images into a viewer that reads none: 600 MB that must not wait anywhere."""
    face = FoxgloveFace(service, "127.0.0.1", free_port())
    face.start()
    try:
        face.publish(mono_ns(), time.time_ns())
        async with Viewer(face.port) as stalled:
            await seen(stalled, ["/robot_description"], lambda: again(face, service))
            before_kb, cpu_s = resident_kb(), time.process_time()
            for number in range(4000):
                service.cell.link.latest = sample(10**9 + number)
                service.cell.vision.latest_preview = (b"\xff\xd8" + bytes(IMAGE_BYTES), 10**9 + number)
                face.publish(10**9 + number, time.time_ns())
            assert (
                resident_kb() - before_kb < 4 * VIEWER_BACKLOG_MESSAGES_MAX * IMAGE_BYTES / 1024
            )  # queue, socket buffers, and slack
            assert (time.process_time() - cpu_s) / 4000 < 0.02  # s a round: what it takes without any viewer, and slack
            async with Viewer(face.port) as other:
                service.cell.link.latest = sample(2 * 10**9, q=(0.7, *Q[1:]))
                found = await seen(other, ["/joint_states"], lambda: again(face, service))
            assert JointStates.FromString(found["/joint_states"]).joints[0].position == 0.7
    finally:
        face.stop()


def again(face, service):
    """The machine has told the same once more."""
    service.cell.link.latest = sample(mono_ns(), service.cell.link.latest.q_rad)
    face._repeat_ns = 0
    face.publish(mono_ns(), time.time_ns())


def resident_kb():
    with open("/proc/self/status", encoding="ascii") as status:
        return next(int(line.split()[1]) for line in status if line.startswith("VmRSS"))


@needs_sdk
async def test_nothing_that_a_viewer_sends_changes_anything(service):
    face = FoxgloveFace(service, "127.0.0.1", free_port())
    face.start()
    try:
        async with websockets.connect(f"ws://127.0.0.1:{face.port}", subprotocols=[PROTOCOL]) as viewer:
            info = json.loads(await viewer.recv())
            assert info["op"] == "serverInfo"
            assert not {"clientPublish", "parameters", "services"} & set(info["capabilities"])
    finally:
        face.stop()


def test_beyond_this_computer_it_must_be_permitted():
    check_foxglove(FoxgloveSettings(host="0.0.0.0"))  # off
    with pytest.raises(SettingsError, match="without_keys"):
        check_foxglove(FoxgloveSettings(enabled=True, host="0.0.0.0"))


@needs_sdk
async def test_a_port_that_is_taken_is_refused_by_name(service):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(SettingsError, match=r"\[foxglove\]"):
            FoxgloveFace(service, "127.0.0.1", taken.getsockname()[1]).start()


async def until(is_so):
    while not is_so():  # noqa: ASYNC110 - the system has no event for it
        await asyncio.sleep(0.02)


def connect_idly(port, count):
    """Connections of another process, that say nothing."""
    code = (
        f"import contextlib, socket, sys\nkept = []\nwith contextlib.suppress(OSError):\n  for _ in range({count}):\n"
        f"    kept.append(socket.create_connection(('127.0.0.1', {port})))\n"
        "print('there', flush=True)\nsys.stdin.read()"
    )
    other = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    other.stdout.readline()
    return other


@needs_sdk
@pytest.mark.skipif(not os.path.isdir("/proc/self/fd"), reason="descriptors cannot be counted here")
async def test_it_gives_its_descriptors_back_before_a_stop_has_none(service, monkeypatch, caplog):
    monkeypatch.setattr(shell, "FACE_RESTART_DELAY_S", 0.5)
    limit = 2 * len(os.listdir("/proc/self/fd")) + 200
    monkeypatch.setattr(shell.resource, "getrlimit", lambda _which: (limit, limit))
    async with foxglove_face(service, FoxgloveSettings(enabled=True, port=free_port())) as face:
        before, port = len(os.listdir("/proc/self/fd")), face.port
        other = await asyncio.to_thread(connect_idly, port, limit - before)
        try:
            async with asyncio.timeout(30.0):
                await until(lambda: "closed for" in caplog.text)
                await until(lambda: not face._aside)
        finally:
            other.communicate()
        async with asyncio.timeout(30.0):  # and is there again
            await until(lambda: face._server is not None and len(os.listdir("/proc/self/fd")) <= before + 20)
            async with Viewer(port) as viewer:
                await viewer.take()


@needs_sdk
async def test_a_stop_has_a_descriptor_while_the_viewers_are_still_being_closed(service, monkeypatch):
    face = FoxgloveFace(service, "127.0.0.1", free_port())
    face.listen()
    server, face._server = face._server, SimpleNamespace(stop=lambda: time.sleep(1.0))  # as idle handshakes make it
    server.stop()
    before = len(os.listdir("/proc/self/fd"))
    stopping = asyncio.create_task(asyncio.to_thread(face.stop))
    async with asyncio.timeout(30.0):
        await until(lambda: not face._aside)
    assert not stopping.done()
    assert len(os.listdir("/proc/self/fd")) <= before - shell.SPARE_DESCRIPTORS_MIN // 2 + 8
    await stopping
