"""valve_asymmetry: one direction is faster than the other at the same command."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="valve_asymmetry",
    stage="actuator",
    scope="joint",
    parameters=(
        Parameter(
            name="gain_frac",
            unit="1",
            low=-0.6,
            high=0.6,
            start=0.12,
            prior=Prior("normal", 0.1),
            meaning="flow gain on positive commands times (1 + gain_frac)",
        ),
    ),
    looks_like="speed over command has another slope for positive commands",
    distinguished_by="flow_gain_error scales both signs; internal_leakage shifts both signs the same way, also at rest",
    source="area ratio of single-rod cylinders (bore 80, rod 45 mm: 0.68)",
)
