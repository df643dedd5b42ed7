"""controller_saturation: the controller clips its output below full command."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="controller_saturation",
    stage="controller",
    scope="joint",
    parameters=(
        Parameter(
            name="limit_frac",
            unit="1",
            low=0.05,
            high=0.99,
            start=0.5,
            prior=Prior("uniform"),
            meaning="largest valve command, of full command",
            neutral=1.0,
        ),
    ),
    looks_like="the valve command is cut flat at one size, both signs",
    distinguished_by="reference_rate_limit cuts the reference's speed; supply_droop leaves the command alone",
    source="contract of the gap diagnosis",
    prevalence=0.05,
)
