"""The shipped machine and a few drawn worlds."""

from pathlib import Path

import pytest

from machine.description import parse_machine_toml
from sim_plc.draw_world import draw_world

MACHINE_FILE = Path(__file__).parents[3] / "machine" / "machines" / "hiab033.toml"


@pytest.fixture(scope="session")
def nominal():
    return parse_machine_toml(MACHINE_FILE.read_text(encoding="utf-8"))


@pytest.fixture(scope="session")
def realistic(nominal):
    return draw_world(nominal, "realistic", 3)


@pytest.fixture(scope="session")
def ideal(nominal):
    return draw_world(nominal, "ideal", 3)
