"""The live stream read by Foxglove's own client library, npm's @foxglove/ws-protocol.

npm install --prefix build/foxglove @foxglove/ws-protocol@0.8.0 ws     # or LONGREACH_FOXGLOVE_CLIENT: another folder
"""

import asyncio
import contextlib
import json
import os
import shutil
import time
from base64 import b64decode
from pathlib import Path

import pytest
from test_live_stream import IMAGE_BYTES, KINDS, again, free_port, needs_sdk, resident_kb, sample, service

from machine.urdf import urdf_text
from recording.clock import mono_ns
from server.faces.foxglove import VIEWER_BACKLOG_MESSAGES_MAX, FoxgloveFace
from server.jobs.engine import Job, JobEvent

__all__ = ["service"]
HERE = Path(__file__).parent
LIBRARY = Path(os.environ.get("LONGREACH_FOXGLOVE_CLIENT") or HERE.parents[2] / "build" / "foxglove").resolve()
NODE = shutil.which("node")
ALL = (*KINDS, "/robot_description", "/tool_error")
pytestmark = [
    needs_sdk,
    pytest.mark.timeout(300),
    pytest.mark.skipif(
        NODE is None or not (LIBRARY / "node_modules" / "@foxglove" / "ws-protocol").is_dir(),
        reason="node or @foxglove/ws-protocol is not installed: see the head of this file",
    ),
]


@pytest.fixture
def face(service):
    made = FoxgloveFace(service, "127.0.0.1", free_port())
    made.start()
    yield made
    made.stop()


@contextlib.asynccontextmanager
async def viewer(face, topics, *more):
    """A process of its own; its lines, while the machine goes on."""
    arguments = (str(HERE / "viewer.mjs"), str(LIBRARY), str(face.port), ",".join(topics), *more)
    process = await asyncio.create_subprocess_exec(
        NODE, *arguments, stdout=asyncio.subprocess.PIPE, limit=4 * IMAGE_BYTES
    )
    try:
        yield process.stdout
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.wait()


async def read(lines, face, service, topics):
    """The server's greeting, and the first message of each topic."""
    greeting, found = {}, {}
    async with asyncio.timeout(120.0):
        while set(found) < set(topics):
            line = None
            reading = asyncio.create_task(lines.readline())
            while line is None:
                again(face, service)
                service.cell.vision.latest_preview = (b"\xff\xd8" + bytes(IMAGE_BYTES), mono_ns())
                face.note(Job("1", "look", "anna"), JobEvent(1, 0.0, "look", 0.0, 1.0, "", "look 1"))
                await asyncio.wait([reading], timeout=0.05)
                line = reading.result() if reading.done() else None
            said = json.loads(line)
            assert "error" not in said, said
            if "topic" in said:
                found[said["topic"]] = said
            else:
                greeting = said
    return greeting, found


async def test_robot_joints_frames_image_errors_and_log_are_read(face, service):
    async with viewer(face, ALL) as lines:
        greeting, found = await read(lines, face, service, ALL)
    assert greeting["server"] == "longreach"
    assert not {"clientPublish", "parameters", "services"} & set(greeting["capabilities"])
    read_ = {topic: kind.FromString(b64decode(found[topic]["base64"])) for topic, kind in KINDS.items()}
    names = [joint.name for joint in service.cell.machine.joints]
    assert [joint.name for joint in read_["/joint_states"].joints] == names
    assert ("tcp", "cam_left") in {(edge.parent_frame_id, edge.child_frame_id) for edge in read_["/tf"].transforms}
    assert len(read_["/camera/left"].data) == IMAGE_BYTES + 2
    assert read_["/log"].message == "look: look 1"
    description = json.loads(b64decode(found["/robot_description"]["base64"]))["data"]
    assert description == urdf_text(service.cell.machine)
    assert json.loads(b64decode(found["/tool_error"]["base64"]))["z_mm"] == 300
    for topic, kind in KINDS.items():
        assert (found[topic]["encoding"], found[topic]["schemaName"]) == ("protobuf", kind.DESCRIPTOR.full_name)


async def test_one_that_stalls_costs_nothing_and_the_other_sees_the_present(face, service):
    """1,000 images into a viewer that reads none."""
    async with viewer(face, ["/tf"], "stall") as stalled:
        await read(stalled, face, service, ["/tf"])
        before_kb, cpu_s = resident_kb(), time.process_time()
        for number in range(1000):
            service.cell.link.latest = sample(10**9 + number)
            service.cell.vision.latest_preview = (b"\xff\xd8" + bytes(IMAGE_BYTES), 10**9 + number)
            face.publish(10**9 + number, time.time_ns())
        assert (time.process_time() - cpu_s) / 1000 < 0.02  # s a round, with the library's own threads
        assert resident_kb() - before_kb < 4 * VIEWER_BACKLOG_MESSAGES_MAX * IMAGE_BYTES / 1024
        service.cell.link.latest = sample(2 * 10**9, q=(0.7, 0.0, 0.0, 0.0, 0.0, 0.0))
        async with viewer(face, ["/joint_states"]) as lines:
            _, found = await read(lines, face, service, ["/joint_states"])
        joints = KINDS["/joint_states"].FromString(b64decode(found["/joint_states"]["base64"])).joints
        assert joints[0].position == 0.7
