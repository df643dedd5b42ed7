"""Diagnose a recording: how far the nominal model misses the tool, and which effects explain it.

python examples/06_diagnose.py RECORDING [RECORDING ...]
"""

import sys

import longreach

if len(sys.argv) < 2:
    raise SystemExit(__doc__)
budget = longreach.diagnose(sys.argv[1:])
print(f"verdict: {budget.verdict} ({budget.verdict_reason})")
for line in budget.effect_lines:
    print(f"{line.probability:5.0%}  {line.tool_rms_mm:6.2f} mm  {line.status:12s} {line.evidence.effect_term}")
