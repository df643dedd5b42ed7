"""The live stream to Foxglove: the robot, its joints and frames, the left image, errors and the log. Nothing is taken.

Foxglove's own SDK serves it from threads of its own. Each viewer has a bounded queue from which the oldest message is
dropped, so one that stalls costs neither the link nor the other viewers anything.
"""

import asyncio
import json
import math
import os
import threading
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import asdict
from typing import Any

from google.protobuf.message import Message
from mcap_protobuf.schema import build_file_descriptor_set

from machine.urdf import urdf_text
from recording.clock import mono_ns
from recording.foxglove import (
    STRING_SCHEMA,
    STRING_SCHEMA_NAME,
    description_json,
    image_message,
    joint_states_message,
    log_message,
    transforms_message,
)
from recording.writer import IMAGE_TOPIC, JOINT_TOPIC, LOG_TOPIC, ROBOT_DESCRIPTION_TOPIC, TRANSFORM_TOPIC
from server.errors import SettingsError
from server.faces.shell import give_way, import_extra, require_own_computer, running_face, set_aside
from server.jobs.engine import Job, JobEvent
from server.jobs.service import JobService
from server.recorder_rows import frame_poses
from server.settings import FoxgloveSettings

ERROR_TOPIC = "/tool_error"
STREAM_PERIOD_S = 0.1
STATIC_REPEAT_PERIOD_S = 2.0  # description and last error: a viewer that comes later has them within this time
RELEASE_S, STOP_S = 0.2, 3.0  # its stop accepts nothing more from its beginning, and waits for idle connections
VIEWER_BACKLOG_MESSAGES_MAX = 64  # messages of one viewer: some seconds, at most 10 MB of images


class FoxgloveFace:
    """Belongs to the event loop; the library's threads send."""

    def __init__(self, service: JobService, host: str, port: int) -> None:
        self._service, self._host, self._port = service, host, port
        self._library = load_library()
        self._context = self._library.Context()
        self._urdf = urdf_text(service.cell.machine)
        self._names = [joint.name for joint in service.cell.machine.joints]
        self._channels: dict[str, Any] = {}
        self._server: Any = None
        self._aside: list[int] = []  # descriptors that viewers cannot take; a STOP has them while it is being stopped
        self._sample_ns = self._image_ns = self._repeat_ns = 0

    @property
    def port(self) -> int:
        """Where it listens."""
        return self._server.port

    def start(self) -> None:
        """Listen, and note what jobs say. Raises: SettingsError: the port is taken."""
        self.listen()
        self._service.engine.on_event(self.note)

    def listen(self) -> None:
        """Listen. Raises: SettingsError: the port is taken."""
        try:
            self._server = self._library.start_server(
                name="longreach",
                host=self._host,
                port=self._port,
                context=self._context,
                message_backlog_size=VIEWER_BACKLOG_MESSAGES_MAX,
            )
        except Exception as error:  # the library's own; it has no class for a port that is taken
            raise SettingsError(f"[foxglove] {self._host}:{self._port}: {error}; choose another port") from error
        self._aside += set_aside()

    def stop(self) -> None:
        """Stop listening."""
        server, self._server = self._server, None
        if server is not None:
            stopping = threading.Thread(target=server.stop, name="foxglove-stop", daemon=True)
            stopping.start()
            stopping.join(RELEASE_S)
            while self._aside:
                os.close(self._aside.pop())
            stopping.join(STOP_S)

    async def run(self) -> None:
        """Publish what is new until cancelled."""
        while True:
            await give_way("foxglove", self.stop, self.listen)
            self.publish(mono_ns(), time.time_ns())
            await asyncio.sleep(STREAM_PERIOD_S)

    def publish(self, now_ns: int, utc_ns: int) -> None:
        """What has come since the last call. Returns immediately, however slow a viewer is."""
        cell, offset_ns = self._service.cell, utc_ns - now_ns
        latest, preview = cell.link.latest, cell.vision.latest_preview
        if latest is not None and latest.t_mono_ns != self._sample_ns:
            self._sample_ns = latest.t_mono_ns
            t_ns = latest.t_mono_ns + offset_ns
            self._message(JOINT_TOPIC, joint_states_message(self._names, latest.q_rad[: len(self._names)], t_ns), t_ns)
            poses = frame_poses(cell.chain, cell.machine.T_tcp_cam_left, latest.q_rad[: len(self._names)])
            self._message(TRANSFORM_TOPIC, transforms_message(poses, t_ns), t_ns)
        if preview is not None and preview[1] != self._image_ns:
            self._image_ns = preview[1]
            t_ns = preview[1] + offset_ns
            self._message(IMAGE_TOPIC, image_message(preview[0], t_ns), t_ns)
        if now_ns - self._repeat_ns >= STATIC_REPEAT_PERIOD_S * 1e9:
            self._repeat_ns = now_ns
            self._log_json(ROBOT_DESCRIPTION_TOPIC, description_json(self._urdf), utc_ns)
            look = cell.knowledge.last_look
            if look is not None and look.error is not None:
                values = {name: value for name, value in asdict(look.error).items() if math.isfinite(value)}
                self._log_json(ERROR_TOPIC, json.dumps(values), utc_ns)

    def note(self, job: Job, event: JobEvent) -> None:
        """A line of a job."""
        if self._server is not None and event.text:
            t_ns = time.time_ns()
            level = "error" if job.code else "info"
            self._message(LOG_TOPIC, log_message(level, f"{job.kind}: {event.text}", t_ns), t_ns)

    def _message(self, topic: str, message: Message, t_utc_ns: int) -> None:
        channel = self._channels.get(topic)
        if channel is None:
            data = build_file_descriptor_set(type(message)).SerializeToString()
            channel = self._create_channel(topic, message.DESCRIPTOR.full_name, "protobuf", data, "protobuf")
        channel.log(message.SerializeToString(), log_time=t_utc_ns)

    def _log_json(self, topic: str, text: str, t_utc_ns: int) -> None:
        channel = self._channels.get(topic)
        if channel is None:
            name, data = (
                (STRING_SCHEMA_NAME, STRING_SCHEMA)
                if topic == ROBOT_DESCRIPTION_TOPIC
                else ("tool_error", b'{"type": "object"}')
            )
            channel = self._create_channel(topic, name, "jsonschema", data, "json")
        channel.log(text.encode(), log_time=t_utc_ns)

    def _create_channel(self, topic: str, name: str, described: str, data: bytes, encoding: str) -> Any:
        schema = self._library.Schema(name=name, encoding=described, data=data)
        channel = self._library.Channel(topic, schema=schema, message_encoding=encoding, context=self._context)
        self._channels[topic] = channel
        return channel


def check_foxglove(settings: FoxgloveSettings) -> None:
    """Whether it can be as the settings want it.

    Raises: SettingsError: no library, or reachable from other computers without leave.
    """
    if settings.enabled:
        require_own_computer("foxglove", settings, "the stream")
        load_library()


def load_library() -> Any:
    """Foxglove's SDK. Raises: SettingsError: it is not installed."""
    return import_extra("foxglove", "foxglove", "foxglove-sdk")


@asynccontextmanager
async def foxglove_face(service: JobService, settings: FoxgloveSettings) -> AsyncIterator[FoxgloveFace | None]:
    """Inside it the stream is up, if it is wanted. Raises: SettingsError: it is wanted and cannot be."""
    if not settings.enabled:
        yield None
        return
    face = FoxgloveFace(service, settings.host, settings.port)
    face.start()
    try:
        async with running_face(
            "foxglove", face.run(), "the Foxglove stream has ended: restart the server to have it again"
        ):
            yield face
    finally:
        await asyncio.to_thread(face.stop)
