"""base_tilt: the base stands out of level."""

from machine.effects.spec import Direction, Effect, Parameter, Prior

EFFECT = Effect(
    name="base_tilt",
    stage="structure",
    scope="machine",
    parameters=(
        Parameter(
            name="tilt_rad",
            unit="rad",
            low=0.0,
            high=0.1,
            start=0.005,
            prior=Prior("half_normal", 0.01),
            meaning="rotation of the base about the axis",
        ),
    ),
    direction=Direction("axis", (1.0, 0.0, 0.0), "base", fitted=2),  # about the upright it is the first encoder's bias
    looks_like="the whole arm is turned about the base: height error in proportion to reach, once a turn of slew",
    distinguished_by="without an outside frame that is level it cannot be seen; base_compliance changes with the load",
    source="set-up of a crane on a vehicle or floor",
    prevalence=0.3,
)
