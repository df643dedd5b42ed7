"""reference_quantisation: the reference is rounded on its way."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="reference_quantisation",
    stage="link",
    scope="joint",
    parameters=(
        Parameter(
            name="step_rad",
            unit="rad",
            low=0.0,
            high=0.01,
            start=0.001,
            prior=Prior("half_normal", 0.001),
            meaning="the received reference is a whole multiple of it",
        ),
    ),
    looks_like="the received reference moves in equal stairs, most visible at slow motion",
    distinguished_by="packet_loss gives stairs of unequal height at random times; a gap that depends on the value only",
    source="integer set-points of field buses",
    prevalence=0.05,
    threshold=True,
)
