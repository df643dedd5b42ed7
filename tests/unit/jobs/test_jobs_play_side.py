"""Where joints rest in their play is told by the encoders, whoever moved the machine and however a motion ended."""

import asyncio
from types import SimpleNamespace

import numpy as np
from test_jobs_plans import World, context, run

from recording.clock import mono_ns
from server.jobs.performer import Performer
from server.jobs.plans.looking import good_look
from server.jobs.requests import MachineReading, ReadMachine, Settle

PLAYED = [0, 3, 4, 5]  # joints of this class that have play


class Link:
    """As much of the link client as a reading needs."""

    def __init__(self):
        self.latest = None

    def samples_since(self, t_mono_ns):
        return [self.latest]


def performer_and_link():
    link = Link()
    vision = SimpleNamespace(on_report=lambda callback: None)
    cell = SimpleNamespace(link=link, vision=vision, chain=SimpleNamespace(n=6))
    return Performer(cell), link  # type: ignore[arg-type]


def hear(performer, link, qs, t_from_s=1.0):
    for i, q in enumerate(qs):
        link.latest = SimpleNamespace(
            t_plc_ns=round(1e9 * (t_from_s + 0.01 * i)),
            t_mono_ns=mono_ns(),
            q_rad=(float(q),) * 6,
            q_ref_rad=(0.0,) * 6,
            oil_temperature_c=0.0,
        )
        performer.observe_plc_sample(link.latest)
    reading = asyncio.run(performer.perform(ReadMachine()))
    assert isinstance(reading, MachineReading)
    return reading.side[PLAYED]


def test_a_motion_moved_back_by_hand_is_seen_without_any_job():
    performer, link = performer_and_link()
    assert np.all(hear(performer, link, np.linspace(0.0, 0.02, 30)) == 1.0)
    assert np.all(hear(performer, link, np.linspace(0.02, 0.01, 30), 1.3) == -1.0)


def test_after_a_silence_no_side_is_known():
    performer, link = performer_and_link()
    hear(performer, link, np.linspace(0.0, 0.02, 30))
    assert np.all(hear(performer, link, [0.02], 2.0) == 0.0)


def test_a_look_never_keeps_a_side_that_no_encoder_told():
    world, ctx = World(), context()
    ctx.knowledge.backlash_sides = -np.ones(6)  # from a motion that was stopped on its way, say
    run(good_look(ctx), world)
    assert np.all(ctx.knowledge.look_observations[-1].backlash_sides == 0.0)


def test_a_look_takes_the_side_that_its_own_reading_tells():
    class Followed(World):
        def perform(self, request):
            reply = super().perform(request)
            if isinstance(request, Settle):
                return MachineReading(reply.q_rad, reply.q_ref_rad, reply.t_plc_ns, reply.t_mono_ns, side=-np.ones(6))
            return reply

    world, ctx = Followed(), context()
    run(good_look(ctx), world)
    assert np.all(ctx.knowledge.look_observations[-1].backlash_sides == -1.0)
