"""Plant and PLC program together, one millisecond at a time; whoever calls decides what time is."""

import secrets
from collections.abc import Callable

import numpy as np

from protocol.framing import EapFraming, Framing, RawFraming
from sim_plc.plant.plant import Plant
from sim_plc.plc.logic import PlantSample, PlcLogic
from sim_plc.pose_feed import PoseFeed
from sim_plc.truth_log import TruthLog
from sim_plc.world import World

CYCLE_NS = 1_000_000
PLC_NET_ID = "10.0.0.2.1.1"
PC_NET_ID = "10.0.0.1.1.1"


def framing_of(kind: str) -> Framing:
    """The PLC's framing by name, "raw" or "eap"."""
    return RawFraming() if kind == "raw" else EapFraming.for_plc(PC_NET_ID, PLC_NET_ID)


class MachineLoop:
    """The simulated machine: `advance_to(t)` runs every PLC cycle up to t."""

    def __init__(
        self,
        world: World,
        framing: Framing,
        t_start_ns: int,
        draw_nonce: Callable[[], int] | None = None,
        local_enable: bool = True,
    ) -> None:
        self.plant = Plant(world.plant, world.q_start_rad)
        self.plc = PlcLogic(world.nominal, framing, draw_nonce or (lambda: secrets.randbits(32)), local_enable)
        self.t_plc_ns = t_start_ns
        self.feed: PoseFeed | None = None
        self.truth: TruthLog | None = None

    def advance_to(self, t_plc_ns: int) -> int:
        """Run all cycles due by then; returns how many."""
        count = 0
        while self.t_plc_ns + CYCLE_NS <= t_plc_ns:
            self.cycle()
            count += 1
        return count

    def cycle(self) -> None:
        """One millisecond."""
        self.t_plc_ns += CYCLE_NS
        valves = self.plc.cycle(self.t_plc_ns, self._sample())
        self.plant.step(np.array(valves), 1)
        if self.feed is None and (self.truth is None or not self.truth.due(self.t_plc_ns)):
            return
        T_base_tcp = self.plant.T_base_tcp()
        if self.feed is not None:
            self.feed.publish(self.t_plc_ns, T_base_tcp)
        if self.truth is not None and self.truth.due(self.t_plc_ns):
            self.truth.write(self.t_plc_ns, T_base_tcp, self.plant.q_encoder_rad)

    def _sample(self) -> PlantSample:
        plant = self.plant
        pressures = plant.pressures_pa
        return PlantSample(
            q_rad=tuple(plant.q_encoder_rad.tolist()),
            qd_rad_s=tuple(plant.qd_rad_s.tolist()),
            p_a_pa=tuple(pressures[:, 0].tolist()),
            p_b_pa=tuple(pressures[:, 1].tolist()),
            p_supply_pa=plant.supply_pressure_pa,
            t_oil_c=plant.oil_temperature_c,
        )
