"""Diagnose a recording: how far the nominal model misses the tool, and which effects explain it.

python examples/06_diagnose.py RECORDING [RECORDING ...]
"""

import sys

import longreach

if len(sys.argv) < 2:
    raise SystemExit(__doc__)
budget = longreach.diagnose(sys.argv[1:])
print(f"verdict: {budget.verdict} ({budget.why})")
for line in budget.lines:
    print(f"{line.probability:5.0%}  {line.mm:6.2f} mm  {line.status:12s} {line.evidence.term}")
