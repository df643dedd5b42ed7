"""The server's handle on the link: a stop counts for what is not sent yet, a trajectory or an arming."""

import asyncio
from dataclasses import replace

import numpy as np
import pytest

from server.link.client import LinkClient
from server.link.contracts import ArmRequest, HealthReport, LinkHealth, LinkPhase, RunRequest, StopRequest
from server.link.errors import LinkRefusedError
from server.link.settings import LinkSettings
from server.motion.contracts import JointTrajectory
from server.settings import read_machine

STILL = np.zeros((3, 6))
PATH = JointTrajectory(np.array([0.0, 0.05, 0.1]), STILL, STILL, STILL)
ARMED = LinkHealth(LinkPhase.ARMED, 1.0, 0, 0, 0, 0, 0.0, 0.0, 0.0, 0.0, "", 1)


class Process:
    def __init__(self):
        self.told = []

    async def request(self, request):
        self.told.append(request)


async def test_a_trajectory_that_was_judged_while_the_machine_was_stopped_is_not_sent(monkeypatch):
    judging, judged = asyncio.Event(), asyncio.Event()

    async def judge(self, knots):
        judging.set()
        await judged.wait()

    monkeypatch.setattr(LinkClient, "_check_motion_gate", judge)
    link = LinkClient(LinkSettings(), read_machine("hiab033"))
    link._process = process = Process()
    link._on_report(HealthReport(ARMED, 0))
    running = asyncio.create_task(link.run(PATH))
    await judging.wait()
    await link.stop("operator pressed stop")
    judged.set()
    with pytest.raises(LinkRefusedError, match="stopped before the trajectory was sent"):
        await running
    assert [type(request) for request in process.told] == [StopRequest]
    running = asyncio.create_task(link.run(PATH))  # the next one is sent
    await asyncio.sleep(0.02)
    assert isinstance(process.told[-1], RunRequest)
    running.cancel()
    await asyncio.wait({running}, timeout=1.0)


async def test_an_arming_that_is_under_way_ends_with_a_stop_and_is_not_asked_for_again():
    link = LinkClient(LinkSettings(), read_machine("hiab033"))
    link._process = process = Process()
    link._on_report(HealthReport(replace(ARMED, phase=LinkPhase.DISARMED), 0))
    arming = asyncio.create_task(link.arm())
    await asyncio.sleep(0.02)
    await link.stop("operator pressed stop")
    with pytest.raises(LinkRefusedError, match="stopped while it was being armed"):
        await asyncio.wait_for(arming, 2.0)
    assert [type(request) for request in process.told] == [ArmRequest, StopRequest]
