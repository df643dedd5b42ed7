"""Who uses the link in a drill: arms whenever possible, starts one motion after the other, corrects, steers, resets."""

import random

from benchmarks.link.drill.motions import draw_motion, draw_tail, roughen
from protocol.client_events import ClientPhase
from protocol.client_link import ClientLink
from protocol.errors import LocalProtocolError
from protocol.limits import LimitTable
from protocol.messages import Axes, Knot, pad_to_eight_axes
from protocol.timeouts import MS, TAIL_LEAD_NS
from sim_plc.plc.local_panel import LocalPanel

_REACTION_NS = 60 * MS


class Operator:
    """Looks at one client every 20 ms and asks it for things. All its choices come from `rng`."""

    def __init__(self, table: LimitTable, panel: LocalPanel, rng: random.Random) -> None:
        self.asked: set[tuple[int, int]] = set()
        self.knots: dict[tuple[int, int], tuple[Knot, ...]] = {}
        self.goals: dict[tuple[int, int], Axes] = {}  # where each trajectory must end, tails that were taken included
        self.tails = self.servos = 0
        self._table, self._panel, self._rng = table, panel, rng
        self._traj_id = 0
        self._ready_ns: int | None = None
        self._servo: tuple[Axes, Axes] | None = None  # target and its speed
        self._servo_until_ns = 0
        self._tail_at_ns: int | None = None
        self._tail_goal: Axes = ()

    def begin_anew(self) -> None:
        """A new connection: numbers begin anew."""
        self._traj_id, self._ready_ns, self._servo, self._tail_at_ns = 0, None, None, None

    def act(self, client: ClientLink, t_ns: int) -> None:
        """One look."""
        match client.phase(t_ns):
            case ClientPhase.LINKED if self._reacted(t_ns):
                if self._panel.enable_mode == "panel" and not self._panel.may_arm:
                    self._panel.press_enable()
                client.request_arm()
            case ClientPhase.FAULT if self._reacted(t_ns):
                client.request_reset()
            case ClientPhase.ARMED if not client.busy and self._reacted(t_ns):
                self._start(client, t_ns)
            case ClientPhase.ARMED | ClientPhase.RUNNING if client.busy:
                self._ready_ns = None
                self._steer(client, t_ns)
                self._correct(client, t_ns)
            case _:
                pass

    def _reacted(self, t_ns: int) -> bool:
        """Whether the reaction time has passed since there was something to do."""
        if self._ready_ns is None:
            self._ready_ns = t_ns + self._rng.randrange(_REACTION_NS)
        return t_ns >= self._ready_ns

    def _start(self, client: ClientLink, t_ns: int) -> None:
        self._traj_id += 1
        key = (client.session, self._traj_id)
        self._servo, self._tail_at_ns = None, None
        if self._rng.random() < 0.2:
            client.request_servo(self._traj_id, t_ns)
            self.servos += 1
            self._servo_until_ns = t_ns + self._rng.randrange(300 * MS, 1500 * MS)
            q_ref = client.state.q_ref if client.state else pad_to_eight_axes(())
            self._servo = (q_ref, pad_to_eight_axes(tuple(0.0 for _ in self._table.axes)))
        else:
            state = client.state
            knots = draw_motion(self._table, state.q_ref if state else pad_to_eight_axes(()), self._rng)
            rough = roughen(self._table, knots, self._rng) if self._rng.random() < 0.5 else knots
            if not client.request_run(self._traj_id, rough, t_ns):
                knots = rough
            elif rough is knots or client.request_run(self._traj_id, knots, t_ns):
                return
            self.knots[key], self.goals[key] = knots, knots[-1].q
            if self._rng.random() < 0.4:
                self._tail_at_ns = t_ns + self._rng.randrange(20 * MS, 1000 * MS)
        self.asked.add(key)

    def _steer(self, client: ClientLink, t_ns: int) -> None:
        """Servo mode: a target that changes its mind now and then."""
        if self._servo is None:
            return
        q, qd = self._servo
        try:
            if t_ns >= self._servo_until_ns:
                client.finish_servo()
                self._servo = None
                return
            if self._rng.random() < 0.2:
                share = self._rng.choice((0.0, 0.5, 1.0))
                qd = pad_to_eight_axes(
                    tuple(self._rng.uniform(-share, share) * axis.qd_max for axis in self._table.axes)
                )
            axes = self._table.axes
            ahead = [min(max(a + v * 0.02, x.q_min), x.q_max) for a, v, x in zip(q, qd, axes, strict=False)]
            self._servo = (pad_to_eight_axes(tuple(ahead)), qd)
            if self._rng.random() < 0.97:
                client.set_servo_target(*self._servo, t_ns)
        except LocalProtocolError:
            self._servo = None  # it has ended meanwhile

    def _correct(self, client: ClientLink, t_ns: int) -> None:
        """Replace the tail of the running trajectory by one to somewhere else."""
        key = (client.session, self._traj_id)
        if self._tail_at_ns is None or t_ns < self._tail_at_ns or key not in self.knots or client.state is None:
            return
        self._tail_at_ns = None
        first, tail = draw_tail(
            self._table, self.knots[key], client.state.t_play_ns + client.age_ns(t_ns) + TAIL_LEAD_NS, self._rng
        )
        if not tail:
            return
        try:
            refused = client.request_tail(self._traj_id, first, tail, t_ns)
        except LocalProtocolError:
            return
        if not refused:
            self.tails += 1
            self._tail_goal = tail[-1].q

    def tail_answered(self, key: tuple[int, int], taken: bool) -> None:
        """The client tells what became of the newest tail."""
        if taken:
            self.goals[key] = self._tail_goal
