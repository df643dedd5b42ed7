"""The code that makes, answers and judges a case of the blind benchmarks."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
CASES = ("diagnosis", "machine", "recording", "sim_plc/plant", "benchmarks/diagnosis/sealed")
