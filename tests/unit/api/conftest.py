"""Benches of the served application; see served.py."""

import pytest
from served import Bench, bench


@pytest.fixture
def open_bench(tmp_path):
    """On loopback without keys."""
    made = bench(tmp_path)
    yield made
    made.keeper.database.close()


@pytest.fixture
def keyed(tmp_path) -> Bench:
    """With a key of every role."""
    made = bench(tmp_path, keyed=True)
    yield made
    made.keeper.database.close()
