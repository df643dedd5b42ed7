"""Drawn worlds and a noise model for the tests of the fast world."""

from functools import cache

from benchmarks.reproduce.noise_model import CornerNoise, LookNoise, NoiseModel, OdometryNoise
from machine.description import Machine
from server.settings import read_machine
from sim_plc.draw_world import draw_world
from sim_plc.world import World

QUIET = CornerNoise(0.0, 0.0)
NO_NOISE = NoiseModel(
    LookNoise(QUIET, QUIET), LookNoise(QUIET, QUIET), OdometryNoise(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 15.0), "none"
)
NOISE = NoiseModel(
    LookNoise(CornerNoise(0.02, 0.01), CornerNoise(0.02, 0.02)),
    LookNoise(CornerNoise(0.2, 0.3, -0.3), CornerNoise(0.2, 0.4, -0.4, 0.01, 0.02)),
    OdometryNoise(2e-4, 1e-4, 0.0, 0.1, 5e-5, 5e-5, 4e-5, 15.0),
    "a test",
)


@cache
def machine() -> Machine:
    return read_machine("hiab033")


@cache
def world(preset: str, seed: int) -> World:
    return draw_world(machine(), preset, seed)
