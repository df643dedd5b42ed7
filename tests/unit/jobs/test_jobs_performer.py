"""The performer: what it leaves on and in motion when a job ends early."""

from types import SimpleNamespace

import numpy as np
import pytest

from server.camera.client import VisionClient
from server.camera.contracts import VisionSettings
from server.camera.looking import POSES_MAX, TrackCollector
from server.camera.sources.settings import HttpSource
from server.errors import JobFailedError
from server.jobs.performer import WATCHED_PAIRS_MAX, Performer
from server.jobs.requests import Move, StartOdometry, StartWatching
from server.link.contracts import MotionEnded
from server.motion.contracts import JointTrajectory
from server.settings import read_machine

STILL = np.zeros((3, 6))
PATH = JointTrajectory(np.array([0.0, 0.05, 0.1]), STILL, STILL, STILL)
SEEN = SimpleNamespace(fit_for_look=True, pose_source="stereo", t_exposure_mapped_ns=1, observation="a pair")


class Vision:
    def __init__(self):
        self.dropped = 0

    def on_report(self, callback):
        self.report = callback

    async def set_pose_source(self, name):
        self.source = name

    async def start_odometry(self):
        pass

    def drop_odometry(self):
        self.dropped += 1


class Link:
    latest = None

    def __init__(self, reached=True):
        self.reached = reached

    async def run(self, trajectory):
        return MotionEnded(1, self.reached, "the PLC refused the motion", 0)


def made(link=None):
    recorder = SimpleNamespace(begin_marks=lambda _marks: None, end_marks=lambda: None)
    cell = SimpleNamespace(link=link or Link(), vision=Vision(), chain=SimpleNamespace(n=6), recorder=recorder)
    return Performer(cell), cell.vision


async def test_a_job_cut_short_leaves_neither_odometry_nor_a_growing_list():
    performer, vision = made()
    await performer.perform(StartOdometry())
    await performer.perform(StartWatching("stereo"))
    vision.report(SEEN)
    assert len(performer._watched) == 1
    performer.release()
    vision.report(SEEN)
    assert (performer._watched, vision.dropped) == (None, 1)
    performer.release()  # the next job has left nothing on
    assert vision.dropped == 1


async def test_only_poses_found_as_asked_for_are_watched():
    """A vision process that was started again may begin with the other way."""
    performer, vision = made()
    await performer.perform(StartWatching("mono"))
    vision.report(SEEN)
    vision.report(SimpleNamespace(**(vars(SEEN) | {"pose_source": "mono"})))
    assert len(performer._watched) == 1


async def test_what_is_watched_is_bounded():
    performer, vision = made()
    await performer.perform(StartWatching("stereo"))
    for _ in range(WATCHED_PAIRS_MAX + 5):
        vision.report(SEEN)
    assert len(performer._watched) == WATCHED_PAIRS_MAX


def test_an_odometry_that_nobody_ends_is_bounded():
    taking, pose = TrackCollector(0), SimpleNamespace()
    stamped = SimpleNamespace(t_exposure_ns=1)
    seen = SimpleNamespace(odometry=pose, odometry_run=0, t_exposure_mapped_ns=2, observation=stamped)
    for _ in range(POSES_MAX + 5):
        taking.add(seen)
    assert (len(taking.poses), len(taking._offsets_ns)) == (POSES_MAX, POSES_MAX)


def test_odometry_is_switched_off_once_and_without_a_process_too():
    client, sent = VisionClient(VisionSettings(HttpSource("http://127.0.0.1:9/stream")), read_machine("hiab033")), []
    client._track = TrackCollector(0)
    client.drop_odometry()  # no process
    assert client._track is None
    client._pipe = SimpleNamespace(send=sent.append)
    client._track = TrackCollector(0)
    client.drop_odometry()
    client.drop_odometry()
    assert [command.enabled for command in sent] == [False]


@pytest.mark.parametrize("reached", [True, False])
async def test_a_motion_that_ended_early_may_still_be_going_on(reached):
    """Why it ended may be wrong: the engine stops what may be moving, and only a motion at its end is at rest."""
    performer, _ = made(Link(reached))
    if reached:
        await performer.perform(Move(PATH, "to the goal"))
    else:
        with pytest.raises(JobFailedError, match="ended early"):
            await performer.perform(Move(PATH, "to the goal"))
    assert performer.may_be_moving is not reached
