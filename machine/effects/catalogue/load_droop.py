"""load_droop: a load that pulls speeds the joint up, one that resists slows it down."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="load_droop",
    stage="actuator",
    scope="joint",
    parameters=(
        Parameter(
            name="droop_frac",
            unit="1",
            low=-0.8,
            high=0.8,
            start=0.15,
            prior=Prior("half_normal", 0.15),
            meaning="qd times (1 + droop_frac load sign(qd)), load over the reference torque",
        ),
    ),
    looks_like="speed at the same command depends on load and direction",
    distinguished_by="in one posture it is flow_gain_error plus valve_asymmetry: drive another posture or payload",
    source="orifice flow sqrt(pS - pL); no pressure compensator",
)
