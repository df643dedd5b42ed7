"""A PC end and the PLC program joined in virtual time, over a joint model that follows the nominal actuator."""

from importlib.resources import files

import numpy as np

from machine.description import parse_machine_toml
from protocol.client_link import ClientLink
from protocol.codes import PlcState
from protocol.framing import RawFraming
from protocol.limits import limits_of
from protocol.messages import Knot, pad_to_eight_axes
from sim_plc.plc.local_panel import LocalPanel
from sim_plc.plc.logic import PlcLogic
from sim_plc.plc.sample import PlantSample

MS = 1_000_000
MACHINE = parse_machine_toml((files("machine") / "machines" / "hiab033.toml").read_text(encoding="utf-8"))
TABLE = limits_of(MACHINE.joints)
Q_START = tuple(np.deg2rad([10.0, 40.0, -80.0, 5.0, -40.0, 3.0]).tolist())
GAINS = np.array([joint.velocity_gain_rad_s for joint in MACHINE.joints])


class VirtualPlc:
    """Steps of 1 ms; `lose(direction, t_ns)` decides which datagrams vanish."""

    def __init__(self, seed=1, panel=None, key=b"", dry_run=False):
        self.t_ns = 10_000 * MS
        rng = np.random.default_rng(seed)
        self.panel = panel or LocalPanel()
        self.plc = PlcLogic(MACHINE, RawFraming(), lambda: int(rng.integers(1, 2**32)), self.panel, key, dry_run)
        self.client = ClientLink(TABLE, RawFraming(), session=7, key=key)
        self.q = np.array(Q_START)
        self.qd = np.zeros(len(self.q))
        self.t_oil_c = 40.0
        self.events, self.trace = [], []
        self.silent = False
        self.lose = lambda direction, t_ns: False

    def step(self, ms=1):
        for _ in range(ms):
            self.t_ns += MS
            zeros = np.zeros(len(self.q))
            valves = self.plc.run_cycle(
                self.t_ns, PlantSample(self.q.copy(), self.qd, zeros, zeros, 19e6, self.t_oil_c)
            )
            self.trace.append((self.t_ns, self.plc.state, self.plc.q_ref, self.plc.qd_ref, tuple(valves.tolist())))
            self.q = self.q + valves * GAINS * 1e-3
            if self.t_ns % (10 * MS) == 0 and self.plc.link.peer is not None and not self.lose("state", self.t_ns):
                self.events += self.client.receive(self.plc.send(self.t_ns), self.t_ns)
            if self.t_ns % (20 * MS) == 0 and not self.silent:
                self.events += self.client.poll(self.t_ns)
                datagram = self.client.send(self.t_ns)
                if datagram is not None and not self.lose("command", self.t_ns):
                    self.plc.receive(datagram, self.t_ns, "pc")

    def reconnect(self, session):
        """A fresh client, as after a crash of the old one."""
        self.client = ClientLink(TABLE, RawFraming(), session=session)
        self.silent = False

    def arm(self):
        self.step(200)
        self.client.request_arm()
        self.step(1500)
        assert self.plc.state is PlcState.HOLD

    def run(self, knots, traj_id=1):
        return self.client.request_run(traj_id, knots, self.t_ns)


def quintic_knots(q0, q1, duration_s, step_s=0.05):
    """Rest-to-rest quintic of all joints together, as knots."""
    q0, q1 = np.array(q0), np.array(q1)
    count = round(duration_s / step_s)
    knots = []
    for i in range(count + 1):
        u = i / count
        s = 10 * u**3 - 15 * u**4 + 6 * u**5
        sd = (30 * u**2 - 60 * u**3 + 30 * u**4) / duration_s
        sdd = (60 * u - 180 * u**2 + 120 * u**3) / duration_s**2
        q, qd, qdd = q0 + s * (q1 - q0), sd * (q1 - q0), sdd * (q1 - q0)
        knots.append(
            Knot(
                round(i * step_s * 1e9),
                pad_to_eight_axes(tuple(q)),
                pad_to_eight_axes(tuple(qd)),
                pad_to_eight_axes(tuple(qdd)),
            )
        )
    return tuple(knots)
