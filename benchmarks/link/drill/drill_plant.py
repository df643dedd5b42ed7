"""Stand-ins for the machine in drills: joints that follow their valves at once, or the true plant."""

from typing import Protocol

import numpy as np

from machine.description import Machine
from machine.rotations import Array
from sim_plc.plant.plant import Plant
from sim_plc.plc.sample import PlantSample
from sim_plc.world import World

_SUPPLY_PA = 19e6
_OIL_C = 45.0


class DrillPlant(Protocol):
    """What a drill needs of a machine."""

    def sample(self, pressure: bool) -> PlantSample:
        """The inputs of this cycle; without `pressure` the pump is off."""
        ...

    def step(self, valves: Array, cycle_ms: int) -> None:
        """Let one cycle pass with these valve commands."""
        ...


class IdealPlant:
    """qd = gain * valve, no dynamics: with the P controllers q follows q_ref with a first-order lag."""

    def __init__(self, machine: Machine, q_start: Array) -> None:
        self.q = np.array(q_start, dtype=float)
        self.qd = np.zeros(len(self.q))
        self._gain = np.array([joint.velocity_gain_rad_s for joint in machine.joints])
        self._none = np.zeros(len(self.q))

    def sample(self, pressure: bool) -> PlantSample:
        """The inputs of this cycle."""
        return PlantSample(self.q, self.qd, self._none, self._none, _SUPPLY_PA if pressure else 0.0, _OIL_C)

    def step(self, valves: Array, cycle_ms: int) -> None:
        """Let one cycle pass."""
        self.qd = valves * self._gain
        self.q = self.q + self.qd * (cycle_ms * 1e-3)


class TruePlant:
    """The simulated machine itself."""

    def __init__(self, world: World) -> None:
        self.plant = Plant(world.plant, world.q_start_rad)

    def sample(self, pressure: bool) -> PlantSample:
        """The inputs of this cycle."""
        plant, pressures = self.plant, self.plant.pressures_pa
        supply = plant.supply_pressure_pa if pressure else 0.0
        return PlantSample(
            plant.q_encoder_rad, plant.qd_rad_s, pressures[:, 0], pressures[:, 1], supply, plant.oil_temperature_c
        )

    def step(self, valves: Array, cycle_ms: int) -> None:
        """Let one cycle pass."""
        self.plant.step(valves, cycle_ms)
