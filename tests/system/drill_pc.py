"""A small PC end for the kill drill: arms, plays one move at 0.15 m/s, prints its duration [s], goes on listening."""

import socket
import sys
import time
from importlib.resources import files

import numpy as np

from machine.chain import chain_of
from machine.description import parse_machine_toml
from machine.kinematics import tcp_jacobian
from protocol.client_events import TrajectoryEnded
from protocol.client_link import ClientLink
from protocol.codes import PlcState
from protocol.framing import RawFraming
from protocol.limits import limits_of
from protocol.messages import Knot, pad_to_eight_axes
from protocol.timeouts import COMMAND_PERIOD
from recording.clock import mono_ns

TCP_SPEED_M_S = 0.15
DIRECTION = np.deg2rad([10.0, 3.0, 4.0, 3.0, 2.0, 3.0])  # towards the middle of each range, by sign


def knots_from(q0, machine):
    """A quintic of all joints from rest to rest with that tool speed in its middle; knots every 50 ms."""
    chain = chain_of(machine)
    middle = 0.5 * (chain.q_min + chain.q_max)
    step = DIRECTION * np.where(q0 <= middle, 1.0, -1.0)
    speed = 0.0
    for u in np.linspace(0.3, 0.7, 9):
        s, sd = 10 * u**3 - 15 * u**4 + 6 * u**5, 30 * u**2 - 60 * u**3 + 30 * u**4
        speed = max(speed, float(np.linalg.norm((tcp_jacobian(chain, q0 + s * step) @ step)[:3])) * sd)
    count = int(np.ceil(speed / TCP_SPEED_M_S / 0.05))
    T, knots = count * 0.05, []
    for i in range(count + 1):
        u = i / count
        s, sd = 10 * u**3 - 15 * u**4 + 6 * u**5, (30 * u**2 - 60 * u**3 + 30 * u**4) / T
        sdd = (60 * u - 180 * u**2 + 120 * u**3) / T**2
        knots.append(
            Knot(i * 50_000_000, *(pad_to_eight_axes(tuple(row)) for row in (q0 + s * step, sd * step, sdd * step)))
        )
    return knots


def received(udp, link):
    """What the waiting datagrams lead to."""
    events = []
    while True:
        try:
            events += link.receive(udp.recv(4096), mono_ns())
        except OSError:
            return events


def main(port):
    machine = parse_machine_toml((files("machine") / "machines" / "hiab033.toml").read_text(encoding="utf-8"))
    knots_from(np.zeros(len(machine.joints)), machine)  # compiles before the PLC waits for anything
    link = ClientLink(limits_of(machine.joints), RawFraming(), session=mono_ns() % 0xFFFF_FFFF + 1)
    link.request_arm()
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    udp.setblocking(False)
    moves, asked, deadline_ns = 0, False, mono_ns()
    while True:
        events = received(udp, link)
        now_ns = mono_ns()
        events += link.poll(now_ns)
        if link.closed:
            return main(port)
        if any(isinstance(event, TrajectoryEnded) for event in events):
            asked = False  # a computer that stood still: the PLC did not begin, or ended by itself; it is asked anew
        if not asked and link.linked and link.state and link.state.plc_state is PlcState.HOLD:
            asked, moves = True, moves + 1
            knots = knots_from(np.array(link.state.q_ref[: len(machine.joints)]), machine)
            now_ns = mono_ns()
            refusals = link.request_run(moves, knots, now_ns)
            if refusals:
                sys.exit("; ".join(refusal.as_line for refusal in refusals))
            print(knots[-1].t_ns * 1e-9, flush=True)
        datagram = link.send(now_ns)
        if datagram:
            udp.sendto(datagram, ("127.0.0.1", port))
        deadline_ns += COMMAND_PERIOD.duration_ns
        time.sleep(max(0, deadline_ns - mono_ns()) * 1e-9)


if __name__ == "__main__":
    main(int(sys.argv[1]))
