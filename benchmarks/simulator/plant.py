"""How fast the fine plant runs against the clock."""

import time
from dataclasses import dataclass
from importlib.resources import files

import numpy as np

from machine.description import parse_machine_toml
from sim_plc.draw_world import draw_world
from sim_plc.plant.plant import Plant


@dataclass(frozen=True, slots=True)
class PlantBench:
    """Simulated seconds per second of one core, in one compiled batch and called once per millisecond from Python."""

    preset: str
    seed: int
    simulated_s: float
    first_call_s: float  # compilation or loading of the compiled code
    real_time_factor: float
    real_time_factor_per_ms_calls: float


def bench_plant(seconds: float = 20.0, preset: str = "realistic", seed: int = 1) -> PlantBench:
    """Real-time factor of one drawn machine with all joints moving."""
    machine = parse_machine_toml((files("machine") / "machines" / "hiab033.toml").read_text(encoding="utf-8"))
    world = draw_world(machine, preset, seed)
    plant = Plant(world.plant, world.q_start_rad)
    started = time.perf_counter()
    plant.step(np.zeros(6))
    first_call = time.perf_counter() - started
    command = np.array([0.1, 0.06, 0.06, 0.1, 0.1, 0.1])
    batch, n_batches = 500, max(1, round(seconds * 2.0))
    started = time.perf_counter()
    for i in range(n_batches):
        plant.step(command if i % 2 == 0 else -command, batch)
    batched = time.perf_counter() - started
    n_calls = max(1, round(seconds * 250.0))
    started = time.perf_counter()
    for i in range(n_calls):
        plant.step(command if (i // batch) % 2 == 0 else -command, 1)
    single = time.perf_counter() - started
    return PlantBench(
        preset=preset,
        seed=seed,
        simulated_s=n_batches * batch * 1e-3,
        first_call_s=first_call,
        real_time_factor=n_batches * batch * 1e-3 / batched,
        real_time_factor_per_ms_calls=n_calls * 1e-3 / single,
    )
