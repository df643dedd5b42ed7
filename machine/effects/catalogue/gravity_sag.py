"""gravity_sag: boom and mounting bend under gravity behind the encoder."""

from machine.effects.spec import Effect, Parameter, Prior

EFFECT = Effect(
    name="gravity_sag",
    stage="structure",
    scope="joint",
    parameters=(
        Parameter(
            name="compliance_rad_nm",
            unit="rad/(N m)",
            low=0.0,
            high=1e-05,
            start=1e-06,
            prior=Prior("half_normal", 1e-06),
            meaning="bending at the joint about its axis per torque of gravity",
            lightest=0.01,
        ),
    ),
    looks_like="the tip hangs lower, more so at long reach; the same from both sides of approach",
    distinguished_by=(
        "encoder_bias is the same in every posture; base_compliance turns the whole arm about the base; in one family"
        " of poses sag and bias are equal: vary the reach"
    ),
    source="torsion springs 0.4 to 1.5e6 N m/rad per joint; 25 to 45 mm at full reach",
    prevalence=0.3,
)
