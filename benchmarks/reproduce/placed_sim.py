"""`python -m benchmarks.reproduce.placed_sim`: the simulated machine with its OOI where the paper had it."""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from benchmarks.reproduce.paper_setup import beside, nearer
from longreach.processes import Stack
from machine.rotations import Array
from server.settings import read_machine_text
from sim_plc.plant.plant import Plant
from sim_plc.process import SimSettings, run_sim
from sim_plc.world import World

SetUp = Literal["beside", "nearer"]
PLACES: dict[str, Callable[[World, Array], World]] = {"beside": beside, "nearer": nearer}
PRESET = "paper"


@dataclass(slots=True)
class PlacedStack(Stack):
    """As `Stack`, with preset `paper` in one of the paper's set-ups."""

    set_up: SetUp = "nearer"

    def start_sim(self) -> None:
        """Start PLC and camera of the placed world."""
        if self.truth_log is None:
            raise ValueError("truth_log: the placed simulator is only run to be judged; give a folder")
        words = [self.set_up, self.seed, self.ports.plc, self.ports.camera, self.camera_rate_hz, self.truth_log]
        self._start_module("sim", "benchmarks.reproduce.placed_sim", [str(word) for word in words])


def placed(world: World, set_up: str) -> World:
    """A drawn world in the set-up of that name.

    Raises: NoSetUpError: the OOI would be out of view wherever it is put.
    """
    return PLACES[set_up](world, Plant(world.plant, world.q_start_rad).T_base_tcp())


def main(arguments: list[str]) -> None:
    """set-up, seed, PLC port, camera port, camera rate [Hz], truth folder."""
    set_up, seed, plc_port, camera_port, rate_hz, truth_log = arguments
    settings = SimSettings(
        machine_text=read_machine_text("hiab033"),
        preset=PRESET,
        seed=int(seed),
        plc_port=int(plc_port),
        camera_port=int(camera_port),
        camera_rate_hz=float(rate_hz),
        truth_log=Path(truth_log),
    )
    run_sim(settings, lambda world: placed(world, set_up))


if __name__ == "__main__":
    main(sys.argv[1:])
