"""States made up for the commissioning tests, a link and an engineer that are none."""

import asyncio
from importlib.resources import files

import numpy as np

from machine.chain import chain_of
from machine.description import parse_machine_toml
from protocol.limits import cfg_id, limits_of
from server.commissioning.site import CommissioningOptions, Site
from server.link.contracts import LinkHealth, LinkPhase, MotionEnded, PlcSample
from server.motion.contracts import evaluate_trajectory
from server.settings import ServerSettings

MS = 1_000_000
MACHINE = parse_machine_toml((files("machine") / "machines" / "hiab033.toml").read_text(encoding="utf-8"))
CHAIN = chain_of(MACHINE)
NAMES = [joint.name for joint in MACHINE.joints]
Q = np.deg2rad([0.0, 45.0, -90.0, 0.0, -45.0, 0.0])
N = len(NAMES)


def sample(t_ms, **values):
    zeros = (0.0,) * N
    base = {
        "t_plc_ns": round(t_ms * MS),
        "t_mono_ns": round(t_ms * MS),
        "seq": round(t_ms / 10),
        "q_rad": tuple(Q),
        "qd_rad_s": zeros,
        "q_ref_rad": tuple(Q),
        "qd_ref_rad_s": zeros,
        "valve_frac": zeros,
        "pressure_a_pa": (5e6,) * N,
        "pressure_b_pa": (5e6,) * N,
        "pressure_supply_pa": 2e7,
        "oil_temperature_c": 40.0,
        "plc_state": "HOLD",
        "traj_id": 0,
        "knot_playing": 0,
        "t_play_ns": 0,
        "buffer_us": 0,
        "underruns": 0,
        "fault_bits": 0,
        "reject_code": 0,
        "simulation": True,
    }
    return PlcSample(**(base | values))


def health(phase=LinkPhase.LINKED, **values):
    base = LinkHealth(phase, 5.0, 100, 100, 0, 0, 50.0, 100.0, 200.0, 1.0, "", 7)
    fields = {name: getattr(base, name) for name in base.__dataclass_fields__}
    return LinkHealth(**(fields | {"cfg_id": cfg_id(limits_of(MACHINE.joints))} | values))


class StandInLink:
    """Plays a trajectory in no time. `gain` per joint: 1 follows, -1 runs the wrong way, 0 stands still."""

    def __init__(self, gain=1.0):
        self.health = health()
        self.gain = np.full(N, gain)
        self.q, self.q_ref = Q.copy(), Q.copy()
        self.latest = sample(0.0)
        self.calls, self.callbacks, self.trace = [], [], []
        self.raises = None
        self.t_ms = 0.0

    def samples_since(self, t_mono_ns):
        if self.trace:
            played, self.trace = self.trace, []
            return played
        return [sample(self.t_ms + 10 * i, q_rad=tuple(self.q), q_ref_rad=tuple(self.q_ref)) for i in range(60)]

    def on_sample(self, callback):
        self.callbacks.append(callback)
        return lambda: self.callbacks.remove(callback)

    async def arm(self, timeout_s):
        self.calls.append("arm")
        if self.raises is not None:
            raise self.raises
        self.health = health(LinkPhase.ARMED)

    async def disarm(self):
        self.calls.append("disarm")
        self.health = health(LinkPhase.LINKED, dry_run=self.health.dry_run)

    async def run(self, trajectory):
        self.calls.append("run")
        q_start, disarms = self.q.copy(), self.calls.count("disarm")
        for t_s in np.arange(0.0, trajectory.duration_s, 0.01):
            motion = evaluate_trajectory(trajectory, np.array([t_s]))
            self.q = q_start + self.gain * (motion.q[0] - trajectory.q[0])
            state = sample(
                1e3 * t_s,
                q_rad=tuple(self.q),
                q_ref_rad=tuple(motion.q[0]),
                qd_ref_rad_s=tuple(motion.qd[0]),
                valve_frac=tuple(0.1 * motion.qd[0]),
                plc_state="RUN",
            )
            self.trace.append(state)
            for callback in list(self.callbacks):
                callback(state)
            await asyncio.sleep(0)
            if self.calls.count("disarm") > disarms:
                return MotionEnded(1, False, "disarmed", 0)
        self.q = q_start + self.gain * (trajectory.q[-1] - trajectory.q[0])
        self.q_ref = trajectory.q[-1].copy()
        self.trace.append(sample(1e3 * trajectory.duration_s, q_rad=tuple(self.q), q_ref_rad=tuple(self.q_ref)))
        return MotionEnded(1, True, "reached", 0)


class StandInOperator:
    """Answers from a dict; None where it holds none."""

    def __init__(self, answers=None, leave=True, confirms=True):
        self.answers, self.leave, self.confirms = answers or {}, leave, confirms
        self.asked, self.told, self.leave_asked = [], [], 0

    async def may_move(self, machine_name):
        self.leave_asked += 1
        return self.leave

    async def confirm(self, text):
        self.told.append(text)
        return self.confirms

    async def ask(self, key, question):
        self.asked.append(key)
        return self.answers.get(key)

    def show(self, text):
        self.told.append(text)

    def progress(self, text, current, target, unit):
        pass


def site(link=None, operator=None, vision=None, **options):
    return Site(
        ServerSettings(),
        MACHINE,
        CHAIN,
        link or StandInLink(),
        vision,
        operator or StandInOperator(),
        CommissioningOptions(**options),
    )
