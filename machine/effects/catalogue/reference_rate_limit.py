"""reference_rate_limit: the PLC follows the reference at no more than a set speed."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="reference_rate_limit",
    stage="link",
    scope="joint",
    parameters=(
        Parameter(
            name="rate_rad_s",
            unit="rad/s",
            low=0.005,
            high=3.0,
            start=0.15,
            prior=Prior("log_uniform"),
            meaning="largest speed of the received reference",
            neutral=float("inf"),
        ),
    ),
    looks_like="fast parts of the received reference become straight lines; slow parts are untouched",
    distinguished_by=(
        "transport_delay also shifts slow parts; controller_saturation limits the valve command, not the reference"
    ),
    source="ramp limits of PLC axis blocks",
    prevalence=0.05,
)
