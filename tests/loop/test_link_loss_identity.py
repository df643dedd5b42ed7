"""What is lost on the way costs nothing: q_ref over playback time is the same to the bit as without loss.

The knots are 50 ms apart, as the server's are: a command then carries 300 ms of them, and the next may be 220 ms away.
"""

import random
from functools import cache

import pytest
from link_virtual import MACHINE, MS, NONE, Q_START, TABLE, Played, VirtualLink, playback

from benchmarks.link.drill.motions import knots_between, reach
from protocol.messages import Knot, pad_to_eight_axes
from sim_plc.relay.faults import Faults

MACHINE_CYCLE_NS = round(MACHINE.plc_cycle_s * 1e9)
LOSS = Faults(loss_frac=0.3)
BURSTS = Faults(burst_frac=0.15, burst_length=10)
ONLY_BURSTS = Faults(burst_frac=1.0, burst_length=10)  # ten lost, one passes, and so on


def motion(duration_ms: int, share: float, seed: int) -> tuple[Knot, ...]:
    """From rest to rest; the joints begin and end at times of their own but for the slowest two."""
    rng = random.Random(seed)
    goal, windows = [], []
    for j, axis in enumerate(TABLE.axes):
        start = 0 if j < 2 else 50 * rng.randrange(duration_ms // 100)
        way = share * reach(TABLE, j, (duration_ms - start) * 1e-3)
        goal.append(Q_START[j] + (way if Q_START[j] + way < axis.q_max - 0.05 else -way))
        windows.append((float(start), float(duration_ms)))
    times = list(range(0, duration_ms + 1, 50))
    return tuple(knots_between(pad_to_eight_axes(Q_START), pad_to_eight_axes(tuple(goal)), tuple(windows), times))


MOTIONS = {
    "hard and short": motion(1000, 0.999, 1),
    "hard and long": motion(4000, 0.999, 2),
    "slow": motion(2500, 0.2, 3),
    "of four knots": motion(150, 0.5, 4),
}


@cache
def undisturbed(name: str) -> Played:
    played, ended, link = playback(MOTIONS[name])
    assert ended.reached
    assert link.plc.q_ref == MOTIONS[name][-1].q[:6]
    assert played[-1][0] == MOTIONS[name][-1].t_ns
    assert len(played) == MOTIONS[name][-1].t_ns // MACHINE_CYCLE_NS
    return played


def assert_identical(name: str, to_plc: Faults, to_pc: Faults, seed: int, phase_ms: int = 0) -> VirtualLink:
    played, ended, link = playback(MOTIONS[name], to_plc, to_pc, seed, phase_ms)
    assert ended.reached, ended.reason
    assert link.plc.underruns == 0
    assert played == undisturbed(name)
    return link


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("name", MOTIONS)
def test_thirty_per_cent_lost_both_ways(name: str, seed: int) -> None:
    link = assert_identical(name, LOSS, LOSS, seed, phase_ms=3 * seed)
    lost, taken = link.to_plc.counts.lost + link.to_pc.counts.lost, link.to_plc.counts.taken + link.to_pc.counts.taken
    if taken > 300:
        assert lost / taken > 0.1  # of all, the quiet second before included


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", ["hard and long", "slow", "of four knots"])
def test_bursts_of_ten_commands(name: str, seed: int) -> None:
    link = assert_identical(name, BURSTS, NONE, seed, phase_ms=5 * seed)
    if name == "hard and long":
        assert link.to_plc.counts.burst > 50


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", ["hard and short", "hard and long", "slow", "of four knots"])
def test_one_command_in_eleven_arrives(name: str, seed: int) -> None:
    assert_identical(name, ONLY_BURSTS, NONE, seed, phase_ms=7 * seed)


@pytest.mark.parametrize("after", range(12))
def test_ten_commands_lost_at_any_time_of_a_hard_start(after: int) -> None:
    """The first of the ten is command number `after` since the motion was asked for."""
    link = VirtualLink(NONE, NONE, seed=1).arm()
    first_ns = link.t_ns + (20 * after + 10) * MS
    link.to_plc.faults = Faults(cut_windows_s=((first_ns * 1e-9, (first_ns + 200 * MS) * 1e-9),))
    ended = link.play(MOTIONS["hard and short"])
    assert link.to_plc.counts.cut == 10
    assert ended.reached, ended.reason
    assert link.played == undisturbed("hard and short")


def test_states_lost_in_runs_cost_nothing_either() -> None:
    assert_identical("hard and long", NONE, Faults(burst_frac=0.1, burst_length=8), seed=1)


def test_runs_longer_than_the_watchdog_do_stop_it() -> None:
    """The watch on the identity bites: more than the window holds is no longer the same."""
    played, ended, _ = playback(MOTIONS["hard and long"], Faults(burst_frac=1.0, burst_length=16), NONE)
    assert not ended.reached
    assert len(played) < len(undisturbed("hard and long"))
