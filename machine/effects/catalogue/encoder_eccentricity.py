"""encoder_eccentricity: the encoder's disc sits off its axis."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="encoder_eccentricity",
    stage="joint",
    scope="joint",
    parameters=(
        Parameter(
            name="amplitude_rad",
            unit="rad",
            low=0.0,
            high=0.03,
            start=0.002,
            prior=Prior("half_normal", 0.002),
            meaning="of encoder = true + amplitude sin(order true + phase)",
        ),
        Parameter(
            name="order",
            unit="1",
            low=1.0,
            high=4.0,
            start=1.0,
            prior=Prior("uniform"),
            meaning="whole waves per turn",
            neutral=1.0,
            role="shape",
            integer=True,
        ),
        Parameter(
            name="phase_rad",
            unit="rad",
            low=-3.2,
            high=3.2,
            start=0.7,
            prior=Prior("uniform"),
            meaning="at true angle 0",
            role="shape",
        ),
    ),
    looks_like="a joint error that waves with the angle, once or twice a turn",
    distinguished_by=(
        "gravity_sag also waves once a turn of lift but follows the load; other orders are gears, not the encoder"
    ),
    source="off-centre code discs: eccentricity over grating radius",
    prevalence=0.02,
)
