"""oil_compliance: the load oscillates on the oil column between valve and joint, and the encoder shows it."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="oil_compliance",
    stage="actuator",
    scope="joint",
    parameters=(
        Parameter(
            name="period_s",
            unit="s",
            low=0.0,
            high=0.2,
            start=0.06,
            prior=Prior("half_normal", 0.05),
            meaning="inverse of the actuator's undamped angular frequency, sqrt(inertia / oil stiffness)",
            most=0.5,
        ),
        Parameter(
            name="damping",
            unit="1",
            low=0.01,
            high=0.9,
            start=0.2,
            prior=Prior("log_uniform"),
            meaning="ratio to critical, by friction and leakage",
            neutral=0.2,
            role="shape",
        ),
    ),
    looks_like="the joint itself rings after each change of speed",
    distinguished_by="link_flexibility rings behind the encoder; valve_lag does not ring",
    source="hydraulic natural frequency of a valve-controlled actuator (Merritt 1967)",
    prevalence=0.3,
)
