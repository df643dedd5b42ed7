"""base_compliance: the vehicle or floor gives way under the arm's moment."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="base_compliance",
    stage="structure",
    scope="machine",
    parameters=(
        Parameter(
            name="compliance_rad_nm",
            unit="rad/(N m)",
            low=0.0,
            high=1e-05,
            start=2e-07,
            prior=Prior("half_normal", 3e-07),
            meaning="rotation of the base per moment of gravity about the base's origin",
            lightest=0.01,
        ),
    ),
    looks_like="the whole arm leans towards its load, wherever slew points",
    distinguished_by=(
        "base_tilt stays fixed in the base; gravity_sag of lift bends about the lift axis, not about the base"
    ),
    source="stabiliser legs and sub-frame",
)
