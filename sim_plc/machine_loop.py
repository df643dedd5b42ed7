"""Plant and PLC program together, one PLC cycle at a time; the caller provides the time."""

from collections.abc import Callable
from typing import Literal

from protocol.framing import EapFraming, Framing, RawFraming
from sim_plc.plant.plant import Plant
from sim_plc.plc.local_panel import LocalPanel
from sim_plc.plc.logic import PlcLogic
from sim_plc.plc.sample import PlantSample
from sim_plc.pose_feed import PoseFeed
from sim_plc.truth_log import TruthLog
from sim_plc.world import World

MS = 1_000_000
STATE_PERIOD_NS = 10 * MS
_PRESSURES_EVERY = 10  # cycles: as often as a state is sent


def plc_framing(kind: Literal["raw", "eap"], pc_net_id: str, plc_net_id: str) -> Framing:
    """The PLC's framing by name; raises LocalProtocolError for a bad NetId."""
    return EapFraming.for_plc(pc_net_id, plc_net_id) if kind == "eap" else RawFraming()


class MachineLoop:
    """The simulated machine at rest at time `t_start_ns` of the PLC's clock; `run_cycle` moves it on by one cycle."""

    def __init__(
        self,
        world: World,
        framing: Framing,
        t_start_ns: int,
        draw_nonce: Callable[[], int],
        panel: LocalPanel | None = None,
        key: bytes = b"",
        dry_run: bool = False,
    ) -> None:
        self.plant = Plant(world.plant, world.q_start_rad)
        self.plc = PlcLogic(world.nominal, framing, draw_nonce, panel, key, dry_run)
        self.t_plc_ns = t_start_ns
        self.cycle_ns = self.plc.settings.cycle_ns
        self.feed: PoseFeed | None = None
        self.truth: TruthLog | None = None
        self._tank_pa = world.plant.supply.tank_pa
        self._cycles = 0
        self._pressures = self.plant.pressures_pa

    def run_cycle(self) -> bytes | None:
        """One PLC cycle at `t_plc_ns`, after which plant and clock have moved on by it.

        Returns: the state datagram if one is due and has a receiver. Poses and truth go where they are wanted.
        """
        t_plc_ns = self.t_plc_ns
        valves = self.plc.run_cycle(t_plc_ns, self._sample())
        link = self.plc.link
        due = (link.peer is not None or link.refused is not None) and t_plc_ns % STATE_PERIOD_NS < self.cycle_ns
        datagram = self.plc.send(t_plc_ns) if due else None
        self.t_plc_ns = t_plc_ns + self.cycle_ns
        n_ms = self.t_plc_ns // MS - t_plc_ns // MS  # whole ones, due by now, whatever the cycle
        if n_ms:
            self.plant.step(valves, n_ms)
        self._publish_pose()
        return datagram

    def _publish_pose(self) -> None:
        truth, feed = self.truth, self.feed
        truth_due = truth is not None and truth.due(self.t_plc_ns)
        if feed is None and not truth_due:
            return
        T_base_tcp = self.plant.T_base_tcp()
        if feed is not None:
            feed.publish(self.t_plc_ns, T_base_tcp)
        if truth is not None and truth_due:
            truth.write(self.t_plc_ns, T_base_tcp, self.plant.q_output_rad, self.plant.q_encoder_rad)

    def _sample(self) -> PlantSample:
        plant = self.plant
        if self._cycles % _PRESSURES_EVERY == 0:
            self._pressures = plant.pressures_pa
        self._cycles += 1
        return PlantSample(
            q_rad=plant.q_encoder_rad,
            qd_rad_s=plant.qd_rad_s,
            p_a_pa=self._pressures[:, 0],
            p_b_pa=self._pressures[:, 1],
            p_supply_pa=plant.supply_pressure_pa,
            t_oil_c=plant.oil_temperature_c,
            p_tank_pa=self._tank_pa,
        )
