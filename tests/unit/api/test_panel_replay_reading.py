"""What the page replays of a run: to its end however long it is, and in JSON that a browser takes."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

from recording.messages import ROW_CODEC_BY_TOPIC
from recording.rows import NAN, PlcState
from recording.writer import IMAGE_TOPIC
from server.api import panel_replay_reading
from server.api.panel_replay_reading import PICTURES_MAX, replay_of

SECOND_NS = 1_000_000_000
NONE = (NAN, NAN)


def told(monkeypatch: pytest.MonkeyPatch, messages: list[tuple[str, int, bytes]]):
    made = [(topic, SimpleNamespace(log_time=t_ns, data=data)) for topic, t_ns, data in messages]
    monkeypatch.setattr(panel_replay_reading, "_wanted_messages", lambda _path: iter(made))
    return replay_of(Path("run.mcap"))


@pytest.mark.parametrize("seconds", [60, 400, 3600])
def test_a_long_run_has_pictures_to_its_end(monkeypatch: pytest.MonkeyPatch, seconds: int) -> None:
    shots = [
        (IMAGE_TOPIC, k * SECOND_NS // 5, CompressedImage(data=b"%d" % k).SerializeToString())
        for k in range(5 * seconds)
    ]
    found, pictures = told(monkeypatch, shots)
    times = [one[0] for one in found["pictures"]]
    assert len(times) == len(pictures) <= PICTURES_MAX + 1
    apart = np.diff(times)
    assert apart.max() < 1.5 * apart.min()
    assert times[-1] > seconds - 1.5 * apart.max()
    assert pictures[-1] == b"%d" % round(5 * times[-1])


def test_a_joint_that_was_not_read_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    row = ROW_CODEC_BY_TOPIC[PlcState.topic].encode(
        PlcState(1.0, 1, NONE, NONE, (0.1, NAN), NONE, NONE, NONE, NAN, NAN, plc_state="ARMED")
    )
    found, _ = told(monkeypatch, [(PlcState.topic, 0, row)])
    assert found["joints"] == [[0.0, [5.73, None], "ARMED"]]
    json.dumps(found, allow_nan=False)
