"""The 3D view's process may freeze with its token given: who shows a view never waits for it."""

import multiprocessing
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from web.scene_process import SceneGoneError, SceneProcess
from web.scene_view import SceneView

FAST_S = 0.5


def view(number, picture=None):
    poses = np.eye(4)
    return SceneView(
        q_rad=(float(number),),
        T_base_cam=poses,
        T_base_tool=poses,
        T_base_ooi=None,
        plan=None,
        scrub_frac=1.0,
        track_base_m=np.zeros((60, 3)),
        map_base_m=None,
        picture_jpeg=picture,
    )


@pytest.fixture
def scene():
    """A process as far as the pipe goes; its end is ours to read, or not."""
    made = SceneProcess(None)
    ours, theirs = multiprocessing.Pipe()
    alive = [True]
    made._process = SimpleNamespace(pid=1, is_alive=lambda: alive[0], join=lambda _s: None, kill=theirs.close)
    made._pipe = ours
    made._sender = threading.Thread(target=made._hand_over, args=(ours,), daemon=True)
    made._sender.start()
    yield made, theirs, alive
    made.close()
    theirs.close()


def test_a_frozen_process_holds_nobody_up(scene):
    made, theirs, _ = scene
    theirs.send("next")
    made.show(view(0, b"x" * 4_000_000))
    assert theirs.poll(10.0)  # under way
    begun_s = time.monotonic()
    for number in range(1, 20):
        made.show(view(number, b"x" * 4_000_000))  # far more than the pipe holds
    made.show(view(20))
    assert time.monotonic() - begun_s < FAST_S
    assert theirs.recv().q_rad == (0.0,)  # thawed: what was under way comes whole
    theirs.send("next")
    newest = theirs.recv()
    assert newest.q_rad == (20.0,)
    assert newest.picture_jpeg is not None  # of one that was left out
    assert not theirs.poll(0.1)  # none without a token


def test_it_ends_while_its_process_is_frozen(scene):
    made, theirs, _ = scene
    theirs.send("next")
    made.show(view(1, b"x" * 4_000_000))
    time.sleep(0.1)
    begun_s = time.monotonic()
    made.close()
    assert time.monotonic() - begun_s < 2.0
    made._sender.join(5.0)
    assert not made._sender.is_alive()


def test_a_process_that_has_ended_is_told(scene):
    made, theirs, alive = scene
    theirs.close()
    made.show(view(1))
    made._sender.join(5.0)
    with pytest.raises(SceneGoneError):
        made.show(view(2))
    alive[0] = False
    made._broken = False
    with pytest.raises(SceneGoneError):
        made.show(view(3))
