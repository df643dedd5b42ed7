"""What the panel draws over the left picture comes in the header that goes with it."""

import json
from types import SimpleNamespace

import numpy as np

from server.api.video import overlay_of
from server.camera.contracts import FrameReport
from server.settings import read_machine
from server.vision.contracts import ObjectPose, PairObservation, PoseStatus

LEFT, RIGHT = np.array([[0.0, 300.04], [200.0, 300.0], [0.0, 400.0]]), np.array([[9.0, 9.0], [8.0, 9.0], [9.0, 8.0]])


def test_the_masks_of_the_left_eye_are_in_the_header():
    unseen = ObjectPose("tool", PoseStatus.NOT_SEEN, "", None, None, (), 0.0, 0.0)
    pair = PairObservation(0, unseen, unseen, (), ())
    report = FrameReport(pair, 0, 0, 1, "stereo", None, 15.0, 9.0, 0, (), 1.0, None)
    vision = SimpleNamespace(masks=((LEFT, LEFT + 50.0), (RIGHT,)))
    cell = SimpleNamespace(machine=read_machine("hiab033"), vision=vision)
    header = overlay_of(cell, SimpleNamespace(T_ooi_goal=np.eye(4)), report, 5.0).model_dump_json()
    assert json.loads(header)["masks_px"] == [
        [[0.0, 300.0], [200.0, 300.0], [0.0, 400.0]],
        [[50.0, 350.0], [250.0, 350.0], [50.0, 450.0]],
    ]
