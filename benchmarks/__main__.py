"""`python -m benchmarks ...`: the same commands as `longreach bench ...`, from a checkout."""

from benchmarks.cli import app
from longreach.cli import main

main(app)
