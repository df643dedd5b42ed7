"""One compiled kernel with every dynamic term of link, controller, actuator and joint, switched by values alone.

Each term is an exact identity at its neutral value, so that the nominal model comes out bit by bit. The fixed order is
delay and loss, rounding, rate limit | controller, its lag, its clip | valve hysteresis, lag, nominal spool, dead band,
flow and load, stiction, pump sharing, leakage, friction, oil spring | encoder | backlash, flexibility. Columns of the
parameter arrays are constants of this file, since a compiled cache sees changes of its own file only.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from machine.rotations import Array

# Columns of the joints' parameters (sets, joints, N_JOINT_PARAMETERS).
STEP, RATE, KP_GAIN, PT1_LAG, U_LIMIT = 0, 1, 2, 3, 4
HYSTERESIS, LAG, DEADBAND, FLOW, ASYMMETRY, DROOP, LEAK, BREAKAWAY = 5, 6, 7, 8, 9, 10, 11, 12
BIAS, SCALE, ECC_AMPLITUDE, ECC_ORDER, ECC_PHASE = 13, 14, 15, 16, 17
BACKLASH, FLEX_GAIN, FLEX_HZ, FLEX_DAMPING = 18, 19, 20, 21
KNOWN_GAIN, KNOWN_HZ, KNOWN_DAMPING = 22, 23, 24  # a second oscillation of the same joint
DEADBAND_LOST = 25  # what is taken off every opening, also off a full one
BREAKAWAY_ONCE = 26  # of a joint that, once moving, sticks again only where its spool changes sides
FRICTION, OIL_PERIOD, OIL_DAMPING = 27, 28, 29  # how far the oil yields before a joint moves, and its spring
# Columns of the machine's parameters (sets, N_MACHINE_PARAMETERS).
DELAY, LOSS, FLOW_LIMIT, PAYLOAD = 0, 1, 2, 3
# Columns of the nominal actuators (joints, 5).
KV, WN, ZETA, KP, TAU = 0, 1, 2, 3, 4
# Stages that a run begins and ends with.
LINK, CONTROLLER, ACTUATOR, JOINT = 0, 1, 2, 3
# A link behind its joint: backlash position [rad], its speed, both oscillations [rad] and their speeds.
SIDE, SIDE_D, BEND, BEND_D, KNOWN_BEND, KNOWN_BEND_D = 0, 1, 2, 3, 4, 5
N_LINK_STATES = 6
N_FREE_MOTION_COEFFICIENTS = 8  # coefficients of two free oscillations over one cycle

# Of the breakaway command: below it a moving joint sticks again (Coulomb below static friction)
RESTICK_COMMAND_FRAC = 0.2
PACKET_LOSS_RANDOM_SEED = 0x7061636B65745F6C  # "packet_l": the stream of packet_loss

Late = tuple[int, float]  # by so many whole cycles, and part of one
Gains = tuple[float, float, float]  # 1 / (1 - dead band), and the flow gain out and back [rad/s]
Clock = tuple[float, int, int]  # cycle [s], steps in it, cycles in a logged row
Signals = tuple[Array, NDArray[np.int64], Array, Array, Array]  # sent, latest, ref, enc, u
# Stages first and last, clock, signals, loads and loads per kg, encoders and commands at the start.
Given = tuple[tuple[int, int], Clock, Signals, tuple[Array, Array], tuple[Array, Array]]
Traced = tuple[Array, Array, Array, Array]  # ref, u, enc, link (rows, joints)


@njit(cache=True, inline="always")
def _counter_based_uniform(i: int, seed: int) -> float:
    """Counter-based uniform number in 0..1 (splitmix64): the same for the same datagram, whatever else is drawn."""
    z = np.uint64(i) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(seed)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return float(z >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@njit(cache=True)
def _last_arrived_datagrams(m: int, loss: float, seed: int) -> NDArray[np.int64]:
    """Index of the last datagram that arrived, for each sent one; the first always arrives."""
    kept = np.zeros(m, np.int64)
    for i in range(1, m):
        kept[i] = kept[i - 1] if _counter_based_uniform(i, seed) < loss else i
    return kept


@njit(cache=True, inline="always")
def play_operator(x: float, y: float, half: float) -> float:
    """Play operator: y follows x at a distance of at most `half`."""
    if x - y > half:
        return x - half
    if y - x > half:
        return x + half
    return y


@njit(cache=True, inline="always")
def _encoder_reading(q: float, p: Array) -> float:
    wave = p[ECC_AMPLITUDE] * np.sin(p[ECC_ORDER] * q + p[ECC_PHASE]) if p[ECC_AMPLITUDE] != 0.0 else 0.0
    return q * (1.0 + p[SCALE]) + p[BIAS] + wave


@njit(cache=True)
def _true_angle(encoder: float, p: Array) -> float:
    """The angle that an encoder reading stands for; fixed point, contraction below 0.14 inside the bounds."""
    if p[ECC_AMPLITUDE] == 0.0:
        return (encoder - p[BIAS]) / (1.0 + p[SCALE])
    q = encoder
    for _ in range(16):
        q = (encoder - p[BIAS] - p[ECC_AMPLITUDE] * np.sin(p[ECC_ORDER] * q + p[ECC_PHASE])) / (1.0 + p[SCALE])
    return q


@njit(cache=True, inline="always")
def _first_order_lag_share(dt: float, tau: float) -> float:
    """Share of the way that a first-order lag goes in dt under a held input; 1 without lag."""
    return 1.0 - np.exp(-dt / tau) if tau > 0.0 else 1.0


@njit(cache=True)
def _free_oscillations(p: Array, dt: float, out: Array) -> None:
    """Free motion (N_FREE_MOTION_COEFFICIENTS,) of a joint's first and second oscillation; zeros for an absent one."""
    _free_oscillation(2.0 * np.pi * p[FLEX_HZ], p[FLEX_DAMPING], dt, out[:4])
    if p[KNOWN_GAIN] != 0.0:
        _free_oscillation(2.0 * np.pi * p[KNOWN_HZ], p[KNOWN_DAMPING], dt, out[4:])


@njit(cache=True)
def _free_oscillation(w: float, damping: float, dt: float, out: Array) -> None:
    """Free motion of an underdamped oscillator over dt, exactly: (b, b') -> out (2, 2, row by row) times (b, b')."""
    wd = w * np.sqrt(1.0 - damping * damping)
    fade, c, s = np.exp(-damping * w * dt), np.cos(wd * dt), np.sin(wd * dt)
    out[0], out[1] = fade * (c + damping * w / wd * s), fade * s / wd
    out[2], out[3] = -fade * w * w / wd * s, fade * (c - damping * w / wd * s)


@njit(cache=True, inline="always")
def _delayed_reference(later: float, earlier: float, part: float) -> float:
    """A reference that is late by part of a cycle: on the way from the one of the cycle before."""
    return (1.0 - part) * later + part * earlier if part > 0.0 else later


@njit(cache=True, inline="always")
def _round_and_rate_limit(target: float, ref: float, step: float, most: float) -> float:
    """The reference after rounding to `step`, and no further than `most` from the one before."""
    if step > 0.0:
        target = np.round(target / step) * step
    if target - ref > most:
        return ref + most
    if ref - target > most:
        return ref - most
    return target


@njit(cache=True, inline="always")
def _first_order_lag_step(x: float, slow: float, share: float) -> float:
    """A first-order lag after one step; the input itself where there is none."""
    return x if share == 1.0 else slow + share * (x - slow)


@njit(cache=True, inline="always")
def _next_spool_speed(speed: float, ahead: float, wn: float, zeta: float, dt: float) -> float:
    """A spool's speed after one step, its command so far ahead of it."""
    return speed + dt * (wn * wn * ahead - 2.0 * zeta * wn * speed)


@njit(cache=True, inline="always")
def _stiction_direction(moving: float, x: float, breakaway: float, once: float) -> float:
    """Which way a joint moves that sticks until its spool is open by more than the breakaway command; 0: it sticks.

    `once`: the part of it that a moving joint does not feel again before its spool changes sides.
    """
    if moving != 0.0 and (x * moving <= 0.0 or abs(x) <= RESTICK_COMMAND_FRAC * breakaway):
        moving = 0.0
    if moving == 0.0 and abs(x) > breakaway + once:
        moving = 1.0 if x > 0.0 else -1.0
    return moving


@njit(cache=True, inline="always")
def _valve_flow_speed(x: float, deadband: float, gains: Gains, droop: float, load: float) -> float:
    """Speed of a spool opening: dead band, flow gain by sign, droop by load."""
    inverse_span, gain_up, gain_down = gains
    opening = abs(x) - deadband
    if opening <= 0.0:
        return 0.0
    share = max(1.0 + droop * load, 0.0) if x > 0.0 else max(1.0 - droop * load, 0.0)
    return opening * inverse_span * gain_up * share if x > 0.0 else -opening * inverse_span * gain_down * share


@njit(cache=True)
def _oil_spring_motion(p: Array, dt: float, out: Array) -> None:
    """Free motion (4,) of a joint on its oil's spring over dt; nothing without one."""
    if p[OIL_PERIOD] > 0.0:
        _free_oscillation(1.0 / p[OIL_PERIOD], p[OIL_DAMPING], dt, out)


@njit(cache=True, inline="always")
def _step_on_oil_spring(q: float, q_d: float, at: float, spring: Array) -> tuple[float, float]:
    """Angle and speed of a joint after one step on a spring whose other end is at `at`."""
    off = q - at
    return at + spring[0] * off + spring[1] * q_d, spring[2] * off + spring[3] * q_d


@njit(cache=True, inline="always")
def _step_link_behind_joint(behind: Array, q: float, p: Array, free: Array, cycle_s: float) -> None:
    """One PLC cycle of a link behind its joint: backlash, then the oscillations that it excites."""
    before, before_d = behind[SIDE], behind[SIDE_D]
    behind[SIDE] = play_operator(q, before, 0.5 * p[BACKLASH])
    behind[SIDE_D] = (behind[SIDE] - before) / cycle_s
    kicked = behind[BEND_D] - p[FLEX_GAIN] * (behind[SIDE_D] - before_d)
    behind[BEND_D] = free[2] * behind[BEND] + free[3] * kicked
    behind[BEND] = free[0] * behind[BEND] + free[1] * kicked
    if p[KNOWN_GAIN] != 0.0:
        kicked = behind[KNOWN_BEND_D] - p[KNOWN_GAIN] * (behind[SIDE_D] - before_d)
        behind[KNOWN_BEND_D] = free[6] * behind[KNOWN_BEND] + free[7] * kicked
        behind[KNOWN_BEND] = free[4] * behind[KNOWN_BEND] + free[5] * kicked


@njit(cache=True, nogil=True)
def link_side_course(p: Array, enc: Array, cycle_s: float, side: float = 0.0) -> Array:
    """Link-side angles (m,) of one joint with parameters p (N_JOINT_PARAMETERS,) behind its encoder's readings (m,), a
    row a cycle: what `run_stages` does in its last stage, for one joint and set. `side`: of its play, where it stands
    before the first row: -1 to 1, 0 in the middle.
    """
    free, behind, out = np.zeros(N_FREE_MOTION_COEFFICIENTS), np.zeros(N_LINK_STATES), np.zeros(len(enc))
    _free_oscillations(p, cycle_s, free)
    behind[SIDE] = _true_angle(enc[0], p) + 0.5 * side * p[BACKLASH]
    for k in range(len(enc)):
        _step_link_behind_joint(behind, _true_angle(enc[k], p), p, free, cycle_s)
        out[k] = behind[SIDE] + behind[BEND] + behind[KNOWN_BEND]
    return out


@njit(cache=True, nogil=True)
def run_stages(
    first: int,
    last: int,
    joint: Array,
    machine: Array,
    nominal: Array,
    cycle_s: float,
    substeps: int,
    decimate: int,
    delay_s: float,
    sent: Array,
    latest: NDArray[np.int64],
    kept_in: NDArray[np.int64],
    ref_in: Array,
    enc_in: Array,
    u_in: Array,
    load: Array,
    load_kg: Array,
    enc_start: Array,
    u_start: Array,
    ref_out: Array,
    u_out: Array,
    enc_out: Array,
    link_out: Array,
) -> None:
    """Run stages `first`..`last` of every parameter set over the PLC's cycles; see `machine.effects.dynamics`.

    A joint that is run by itself has all of its numbers in registers: that is most of what a diagnosis runs.
    """
    n = joint.shape[1]
    signals = (sent, latest, ref_in, enc_in, u_in)
    given = ((first, last), (cycle_s, substeps, decimate), signals, (load, load_kg), (enc_start, u_start))
    for s in range(joint.shape[0]):
        G = machine[s]
        late, kept = (0, 0.0), np.zeros(0, np.int64)
        if first == LINK:
            known = G[LOSS] > 0.0 and kept_in.shape[0] > 0
            kept = kept_in if known else _last_arrived_datagrams(sent.shape[0], G[LOSS], PACKET_LOSS_RANDOM_SEED)
            delay = (delay_s + G[DELAY]) / cycle_s
            whole = int(np.floor(delay + 1e-9))
            late = (whole, delay - whole if delay - whole > 1e-9 else 0.0)
        out = (ref_out[s], u_out[s], enc_out[s], link_out[s])
        if n == 1 and G[FLOW_LIMIT] == np.inf:
            _simulate_one_joint(joint[s, 0], G[PAYLOAD], nominal[0], given, kept, late, out)
        else:
            _simulate_coupled_joints(joint[s], G, nominal, given, kept, late, out)


@njit(cache=True, inline="always")
def _flow_gains(p: Array, velocity_gain: float) -> Gains:
    down = velocity_gain * (1.0 + p[FLOW])
    return 1.0 / (1.0 - p[DEADBAND]), down * (1.0 + p[ASYMMETRY]), down


@njit(cache=True, nogil=True)
def _simulate_one_joint(
    p: Array, payload: float, nominal: Array, given: Given, kept: NDArray[np.int64], late: Late, out: Traced
) -> None:
    """A joint run by itself, by one set: p (N_JOINT_PARAMETERS,), nominal (5,). In scalars, for speed."""
    (first, last), (cycle_s, substeps, decimate), (sent, latest, ref_in, enc_in, u_in), loads, begin = given
    (load, load_kg), (enc_start, u_start), (whole, part) = loads, begin, late
    ref_out, u_out, enc_out, link_out = out
    dt = cycle_s / substeps
    step, most, limit = p[STEP], p[RATE] * cycle_s, p[U_LIMIT]
    kp = nominal[KP] * (1.0 + p[KP_GAIN])
    pt1 = _first_order_lag_share(cycle_s, nominal[TAU] * (1.0 + p[PT1_LAG]))
    slow_share, hysteresis, wn, zeta = _first_order_lag_share(dt, p[LAG]), p[HYSTERESIS], nominal[WN], nominal[ZETA]
    deadband, droop, leak, breakaway = p[DEADBAND] + p[DEADBAND_LOST], p[DROOP], p[LEAK], p[BREAKAWAY]
    gains = _flow_gains(p, nominal[KV])
    friction, sprung, spring = p[FRICTION], p[OIL_PERIOD] > 0.0, np.zeros(4)
    _oil_spring_motion(p, dt, spring)
    free, behind = np.zeros(N_FREE_MOTION_COEFFICIENTS), np.zeros(N_LINK_STATES)
    _free_oscillations(p, cycle_s, free)
    ref = float(sent[kept[latest[0]], 0]) if first == LINK else float(enc_start[0])
    enc, q = enc_start[0], _true_angle(enc_start[0], p)
    lagged = u = play = slow = spool = u_start[0]
    spool_d = moving = q_d = 0.0
    oil = pushed = q
    behind[SIDE] = q
    row, until = -1, 0
    for k in range(max(latest.shape[0], ref_in.shape[0], u_in.shape[0], enc_in.shape[0])):
        logged = until == 0
        if logged:
            row, until = row + 1, decimate
        until -= 1
        if first == LINK:
            a, b = int(kept[latest[max(k - whole, 0)]]), int(kept[latest[max(k - whole - 1, 0)]])
            ref = _round_and_rate_limit(_delayed_reference(sent[a, 0], sent[b, 0], part), ref, step, most)
        elif first == CONTROLLER:
            ref = ref_in[k, 0]
        if first <= CONTROLLER and last >= CONTROLLER:
            enc = _encoder_reading(q, p) if last >= ACTUATOR else enc_in[k, 0]
            lagged += pt1 * (kp * (ref - enc) - lagged)
            u = min(max(lagged, -limit), limit)
        elif first == ACTUATOR:
            u = min(max(u_in[k, 0], -1.0), 1.0)
            enc = _encoder_reading(q, p)
        if last == JOINT:
            if first == JOINT:
                q = _true_angle(enc_in[k, 0], p)
            _step_link_behind_joint(behind, q, p, free, cycle_s)
        if logged:
            ref_out[row, 0], u_out[row, 0], enc_out[row, 0] = ref, u, enc
            link_out[row, 0] = behind[SIDE] + behind[BEND] + behind[KNOWN_BEND]
        if first <= ACTUATOR and last >= ACTUATOR:
            pull = load[row, 0] + payload * load_kg[row, 0]
            for _ in range(substeps):
                play = play_operator(u, play, hysteresis)
                slow = _first_order_lag_step(play, slow, slow_share)
                spool_d = _next_spool_speed(spool_d, slow - spool, wn, zeta, dt)
                spool += dt * spool_d
                moving = _stiction_direction(moving, spool, breakaway, p[BREAKAWAY_ONCE])
                speed = _valve_flow_speed(spool, deadband, gains, droop, pull) if moving != 0.0 else 0.0
                oil += dt * (speed + leak * pull)
                pushed = play_operator(oil, pushed, friction)
                if sprung:
                    q, q_d = _step_on_oil_spring(q, q_d, pushed, spring)
                else:
                    q = pushed


@njit(cache=True, nogil=True)
def _simulate_coupled_joints(
    P: Array, G: Array, nominal: Array, given: Given, kept: NDArray[np.int64], late: Late, out: Traced
) -> None:
    """All joints of one set, step by step, since they may share what the pump gives: P (joints, N_JOINT_PARAMETERS)."""
    (first, last), (cycle_s, substeps, decimate), (sent, latest, ref_in, enc_in, u_in), loads, begin = given
    (load, load_kg), (enc_start, u_start), (whole, part) = loads, begin, late
    ref_out, u_out, enc_out, link_out = out
    n = P.shape[0]
    dt = cycle_s / substeps
    ref, lagged, u = np.zeros(n), np.zeros(n), np.zeros(n)
    play, slow, spool, spool_d, speed = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    moving, q, enc, pull = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    oil, pushed, q_d, spring = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros((n, 4))
    behind, free = np.zeros((n, N_LINK_STATES)), np.zeros((n, N_FREE_MOTION_COEFFICIENTS))
    pt1, slow_share, gains = np.zeros(n), np.zeros(n), np.zeros((n, 3))
    for j in range(n):
        pt1[j] = _first_order_lag_share(cycle_s, nominal[j, TAU] * (1.0 + P[j, PT1_LAG]))
        slow_share[j] = _first_order_lag_share(dt, P[j, LAG])
        gains[j, 0], gains[j, 1], gains[j, 2] = _flow_gains(P[j], nominal[j, KV])
        _free_oscillations(P[j], cycle_s, free[j])
        _oil_spring_motion(P[j], dt, spring[j])
        ref[j] = sent[kept[latest[0]], j] if first == LINK else enc_start[j]
        enc[j] = enc_start[j]
        q[j] = _true_angle(enc_start[j], P[j])
        lagged[j] = u[j] = play[j] = slow[j] = spool[j] = u_start[j]
        oil[j] = pushed[j] = behind[j, SIDE] = q[j]
    row, until, a, b = -1, 0, 0, 0
    for k in range(max(latest.shape[0], ref_in.shape[0], u_in.shape[0], enc_in.shape[0])):
        logged = until == 0
        if logged:
            row, until = row + 1, decimate
        until -= 1
        if first == LINK:
            a, b = int(kept[latest[max(k - whole, 0)]]), int(kept[latest[max(k - whole - 1, 0)]])
            for j in range(n):
                ref[j] = _round_and_rate_limit(
                    _delayed_reference(sent[a, j], sent[b, j], part), ref[j], P[j, STEP], P[j, RATE] * cycle_s
                )
        elif first == CONTROLLER:
            for j in range(n):
                ref[j] = ref_in[k, j]
        if first <= CONTROLLER and last >= CONTROLLER:
            for j in range(n):
                enc[j] = _encoder_reading(q[j], P[j]) if last >= ACTUATOR else enc_in[k, j]
                wanted = nominal[j, KP] * (1.0 + P[j, KP_GAIN]) * (ref[j] - enc[j])
                lagged[j] += pt1[j] * (wanted - lagged[j])
                u[j] = min(max(lagged[j], -P[j, U_LIMIT]), P[j, U_LIMIT])
        elif first == ACTUATOR:
            for j in range(n):
                u[j] = min(max(u_in[k, j], -1.0), 1.0)
                enc[j] = _encoder_reading(q[j], P[j])
        if last == JOINT:
            for j in range(n):
                if first == JOINT:
                    q[j] = _true_angle(enc_in[k, j], P[j])
                _step_link_behind_joint(behind[j], q[j], P[j], free[j], cycle_s)
        if logged:
            for j in range(n):
                ref_out[row, j], u_out[row, j], enc_out[row, j] = ref[j], u[j], enc[j]
                link_out[row, j] = behind[j, SIDE] + behind[j, BEND] + behind[j, KNOWN_BEND]
        if first > ACTUATOR or last < ACTUATOR:
            continue
        for j in range(n):
            pull[j] = load[row, j] + G[PAYLOAD] * load_kg[row, j]
        for _ in range(substeps):
            total = 0.0
            for j in range(n):
                wn, zeta = nominal[j, WN], nominal[j, ZETA]
                play[j] = play_operator(u[j], play[j], P[j, HYSTERESIS])
                slow[j] = _first_order_lag_step(play[j], slow[j], slow_share[j])
                spool_d[j] = _next_spool_speed(spool_d[j], slow[j] - spool[j], wn, zeta, dt)
                spool[j] += dt * spool_d[j]
                moving[j] = _stiction_direction(moving[j], spool[j], P[j, BREAKAWAY], P[j, BREAKAWAY_ONCE])
                speed[j] = 0.0
                if moving[j] != 0.0:
                    of = (gains[j, 0], gains[j, 1], gains[j, 2])
                    speed[j] = _valve_flow_speed(
                        spool[j], P[j, DEADBAND] + P[j, DEADBAND_LOST], of, P[j, DROOP], pull[j]
                    )
                total += abs(speed[j]) / nominal[j, KV]
            served = G[FLOW_LIMIT] / total if total > G[FLOW_LIMIT] else 1.0
            for j in range(n):
                oil[j] += dt * (speed[j] * served + P[j, LEAK] * pull[j])
                pushed[j] = play_operator(oil[j], pushed[j], P[j, FRICTION])
                if P[j, OIL_PERIOD] > 0.0:
                    q[j], q_d[j] = _step_on_oil_spring(q[j], q_d[j], pushed[j], spring[j])
                else:
                    q[j] = pushed[j]
