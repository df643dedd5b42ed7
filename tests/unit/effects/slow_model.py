"""The nominal model and all dynamic terms, one joint and one line at a time: what the kernel must compute."""

import math
from dataclasses import dataclass

import numpy as np

from machine.effects import kernel as columns
from machine.effects.dynamics import Actuators, Drive

MASK = (1 << 64) - 1


def nominal_rows(plant: Actuators, drive: Drive) -> tuple[list[list[float]], list[list[float]]]:
    """Valve commands and joints (rows, n) of the nominal model, as its definition says and with nothing else."""
    n, T = plant.n, plant.cycle_s
    dt = T / plant.substeps
    delay = round(plant.transport_delay_s / T)
    q = list(drive.sent[drive.latest_sent_indices[0]])
    lagged, x, xd = [0.0] * n, [0.0] * n, [0.0] * n
    us, qs = [], []
    for k in range(drive.n_cycles):
        q_ref = drive.sent[drive.latest_sent_indices[max(k - delay, 0)]]
        u = [0.0] * n
        for j in range(n):
            kv, wn, zeta, kp, tau = plant.joints[j]
            share = 1.0 - math.exp(-T / tau) if tau > 0.0 else 1.0
            lagged[j] += share * (kp * (q_ref[j] - q[j]) - lagged[j])
            u[j] = min(max(lagged[j], -1.0), 1.0)
        if k % plant.cycles_per_row == 0:
            us.append(list(u))
            qs.append(list(q))
        for _ in range(plant.substeps):
            for j in range(n):
                kv, wn, zeta, kp, tau = plant.joints[j]
                xd[j] += dt * (wn * wn * (u[j] - x[j]) - 2.0 * zeta * wn * xd[j])
                x[j] += dt * xd[j]
                q[j] += dt * (kv * x[j])
    return us, qs


def uniform(i: int, seed: int) -> float:
    z = (i * 0x9E3779B97F4A7C15 + seed) & MASK
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
    return ((z ^ (z >> 31)) >> 11) / 2.0**53


@dataclass
class SlowJoint:
    """One joint's state."""

    p: np.ndarray
    kv: float
    wn: float
    zeta: float
    kp: float
    tau: float
    q: float = 0.0
    ref: float = 0.0
    lagged: float = 0.0
    play: float = 0.0
    slow: float = 0.0
    x: float = 0.0
    xd: float = 0.0
    moving: float = 0.0
    side: float = 0.0
    side_d: float = 0.0
    bend: float = 0.0
    bend_d: float = 0.0
    oil: float = 0.0
    pushed: float = 0.0
    q_d: float = 0.0

    def encoder(self) -> float:
        p = self.p
        wave = p[columns.ECC_AMPLITUDE] * math.sin(p[columns.ECC_ORDER] * self.q + p[columns.ECC_PHASE])
        return self.q * (1.0 + p[columns.SCALE]) + p[columns.BIAS] + wave

    def take_reference(self, target: float, T: float) -> None:
        step, most = self.p[columns.STEP], self.p[columns.RATE] * T
        if step > 0.0:
            target = round(target / step) * step
        self.ref = min(max(target, self.ref - most), self.ref + most)

    def control(self, T: float) -> float:
        tau = self.tau * (1.0 + self.p[columns.PT1_LAG])
        share = 1.0 - math.exp(-T / tau) if tau > 0.0 else 1.0
        wanted = self.kp * (1.0 + self.p[columns.KP_GAIN]) * (self.ref - self.encoder())
        self.lagged += share * (wanted - self.lagged)
        limit = self.p[columns.U_LIMIT]
        return min(max(self.lagged, -limit), limit)

    def valve(self, u: float, dt: float, load: float) -> float:
        p = self.p
        half = p[columns.HYSTERESIS]
        self.play = min(max(self.play, u - half), u + half)
        share = 1.0 - math.exp(-dt / p[columns.LAG]) if p[columns.LAG] > 0.0 else 1.0
        self.slow += share * (self.play - self.slow)
        self.xd += dt * (self.wn**2 * (self.slow - self.x) - 2.0 * self.zeta * self.wn * self.xd)
        self.x += dt * self.xd
        x, breakaway, once = self.x, p[columns.BREAKAWAY], p[columns.BREAKAWAY_ONCE]
        if x * self.moving <= 0.0 or abs(x) <= 0.2 * breakaway:
            self.moving = 0.0
        if self.moving == 0.0 and abs(x) > breakaway + once:
            self.moving = math.copysign(1.0, x)
        if self.moving == 0.0:
            return 0.0
        kept, lost = p[columns.DEADBAND], p[columns.DEADBAND_LOST]
        opening = math.copysign(max(abs(x) - kept - lost, 0.0) / (1.0 - kept), x)
        gain = self.kv * (1.0 + p[columns.FLOW]) * (1.0 + p[columns.ASYMMETRY] * (x > 0.0))
        return opening * gain * max(1.0 + p[columns.DROOP] * load * math.copysign(1.0, x), 0.0)

    def moved_by(self, flow: float, dt: float) -> None:
        half, period = self.p[columns.FRICTION], self.p[columns.OIL_PERIOD]
        self.oil += dt * flow
        self.pushed = min(max(self.pushed, self.oil - half), self.oil + half)
        if period <= 0.0:
            self.q = self.pushed
            return
        matrix = np.array([[0.0, 1.0], [-(period**-2.0), -2.0 * self.p[columns.OIL_DAMPING] / period]])
        off, self.q_d = _expm(matrix * dt) @ np.array([self.q - self.pushed, self.q_d])
        self.q = self.pushed + off

    def link_side(self, T: float) -> float:
        p = self.p
        half, before, before_d = 0.5 * p[columns.BACKLASH], self.side, self.side_d
        self.side = min(max(before, self.q - half), self.q + half)
        self.side_d = (self.side - before) / T
        self.bend_d -= p[columns.FLEX_GAIN] * (self.side_d - before_d)
        w, z = 2.0 * math.pi * p[columns.FLEX_HZ], p[columns.FLEX_DAMPING]
        matrix = np.array([[0.0, 1.0], [-w * w, -2.0 * z * w]])
        self.bend, self.bend_d = _expm(matrix * T) @ np.array([self.bend, self.bend_d])
        return self.side + self.bend


def _expm(A: np.ndarray) -> np.ndarray:
    """Matrix exponential by scaling and a power series."""
    small, total, term = A / 1024.0, np.eye(2), np.eye(2)
    for k in range(1, 12):
        term = term @ small / k
        total = total + term
    return np.linalg.matrix_power(total, 1024)


def slow_rows(plant: Actuators, joint: np.ndarray, machine: np.ndarray, drive: Drive) -> dict[str, np.ndarray]:
    """One set, from the sent reference to the link side: rows (rows, n) of ref, u, enc, link."""
    T, n = plant.cycle_s, plant.n
    dt = T / plant.substeps
    joints = [SlowJoint(joint[j], *plant.joints[j]) for j in range(n)]
    for j, one in enumerate(joints):
        start = float(drive.enc_start[j])
        one.q = one.ref = start
        for _ in range(60):  # the angle that reads `start`
            one.q -= (one.encoder() - start) / (1.0 + one.p[columns.SCALE])
        one.side = one.oil = one.pushed = one.q
        one.ref = float(drive.sent[drive.latest_sent_indices[0], j])
    kept = [0]
    for i in range(1, len(drive.sent)):
        kept.append(kept[-1] if uniform(i, columns.PACKET_LOSS_RANDOM_SEED) < machine[columns.LOSS] else i)
    delay = (plant.whole_delay_s + machine[columns.DELAY]) / T  # the rest of it is in the drive
    rows: dict[str, list[list[float]]] = {"ref": [], "u": [], "enc": [], "link": []}
    for k in range(drive.n_cycles):
        whole = math.floor(delay + 1e-9)
        near, far = (drive.sent[kept[drive.latest_sent_indices[max(k - d, 0)]]] for d in (whole, whole + 1))
        target = near + (delay - whole) * (far - near)
        for j, one in enumerate(joints):
            one.take_reference(float(target[j]), T)
        enc = [one.encoder() for one in joints]
        us = [one.control(T) for one in joints]
        links = [one.link_side(T) for one in joints]
        if k % plant.cycles_per_row == 0:
            for name, values in (("ref", [one.ref for one in joints]), ("u", us), ("enc", enc), ("link", links)):
                rows[name].append(values)
        row = k // plant.cycles_per_row
        load = drive.load[row] + machine[columns.PAYLOAD] * drive.load_kg[row]
        for _ in range(plant.substeps):
            speeds = [one.valve(us[j], dt, load[j]) for j, one in enumerate(joints)]
            total = sum(abs(v) / one.kv for v, one in zip(speeds, joints, strict=True))
            served = min(1.0, machine[columns.FLOW_LIMIT] / total) if total > 0.0 else 1.0
            for j, one in enumerate(joints):
                one.moved_by(speeds[j] * served + one.p[columns.LEAK] * load[j], dt)
    return {name: np.array(values) for name, values in rows.items()}
