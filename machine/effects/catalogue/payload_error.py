"""payload_error: the load at the tip is not the one in the machine file."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="payload_error",
    stage="structure",
    scope="machine",
    parameters=(
        Parameter(
            name="mass_kg",
            unit="kg",
            low=-200.0,
            high=500.0,
            start=50.0,
            prior=Prior("normal", 50.0),
            meaning="carried at the tcp beyond the machine file's masses",
        ),
    ),
    looks_like="all that depends on gravity's torque grows together: sag, leakage, droop",
    distinguished_by="by itself invisible on a rigid arm; a single gravity_sag changes one joint only",
    source="contract of the gap diagnosis",
)
