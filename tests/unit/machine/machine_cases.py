"""The nominal machine and random joint vectors, for the machine's tests."""

from importlib.resources import files

import numpy as np

from machine.chain import chain_of
from machine.description import parse_machine_toml

TEXT = (files("machine") / "machines" / "hiab033.toml").read_text(encoding="utf-8")
MACHINE = parse_machine_toml(TEXT)
CHAIN = chain_of(MACHINE)
QS = np.random.default_rng(7).uniform(CHAIN.q_min, CHAIN.q_max, (1000, CHAIN.n))
