"""link_flexibility: the boom oscillates behind the encoder after each change of speed."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="link_flexibility",
    stage="structure",
    scope="joint",
    parameters=(
        Parameter(
            name="gain",
            unit="1",
            low=0.0,
            high=2.0,
            start=0.3,
            prior=Prior("half_normal", 0.3),
            meaning="deflection's drive per acceleration of the joint",
        ),
        Parameter(
            name="frequency_hz",
            unit="Hz",
            low=0.3,
            high=20.0,
            start=2.5,
            prior=Prior("log_uniform"),
            meaning="of the free oscillation",
            neutral=2.5,
            role="shape",
        ),
        Parameter(
            name="damping",
            unit="1",
            low=0.005,
            high=0.5,
            start=0.04,
            prior=Prior("log_uniform"),
            meaning="ratio to critical",
            neutral=0.04,
            role="shape",
        ),
    ),
    looks_like="a decaying oscillation of the tip that the encoder does not show",
    distinguished_by="backlash does not ring; clock errors follow speed, this one follows acceleration",
    source="first mode 2.3 to 3.5 Hz at full reach, damping 3 to 5 %",
    prevalence=0.05,
)
