import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # the generator is run as benchmarks.diagnosis.sealed from the root
