"""joint_friction: the oil yields until its pressure overcomes the joint's Coulomb friction."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="joint_friction",
    stage="actuator",
    scope="joint",
    parameters=(
        Parameter(
            name="compression_rad",
            unit="rad",
            low=0.0,
            high=5e-3,
            start=5e-4,
            prior=Prior("half_normal", 1e-3),
            meaning="half of what the oil moves at a reversal before the joint follows: friction over oil stiffness",
            most=0.03,
        ),
    ),
    looks_like="a joint starts late after each reversal, by an oil volume and not by a command",
    distinguished_by=(
        "valve_deadband and stiction go with the command: reverse slowly and fast; backlash is not in the encoder"
    ),
    source="Coulomb friction on a compressible oil column: a play operator between oil and joint",
    prevalence=0.3,
    threshold=True,
)
