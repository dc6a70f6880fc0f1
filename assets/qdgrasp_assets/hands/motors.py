"""The motors of a hand's joints, where the URDF's would not do."""

from qdgrasp_assets.hands.body import Body

CLOSING_TIME = 100 / 240
"""How long an evaluation closes the hand [s] (docs/protocols.md)."""
STRONGEST = {True: 200.0, False: 2000.0}
"""No finger has more effort: joints that turn [Nm], joints that slide [N]."""
USUAL = {True: 20.0, False: 100.0}
"""What joints get that have none, or too much."""


def motor(body: Body, name: str, travel: float) -> tuple[float | None, float | None, tuple[str, ...]]:
    """Effort [Nm or N] and velocity [rad/s or m/s], None where the URDF's will do; and why they will not.

    `travel` is from open to closed [rad or m].
    """
    joint, effort, velocity, notes = body.joint(name), None, None, []
    turns = joint.kind != "prismatic"
    if not 0 < joint.effort <= STRONGEST[turns]:
        effort = USUAL[turns]
        notes.append(f"the URDF's effort would be {joint.effort:g} {'Nm' if turns else 'N'}")
    if joint.velocity * CLOSING_TIME < travel or joint.velocity <= 0:
        velocity = round(max(1.25 * travel / CLOSING_TIME, 0.1), 2)
        unit = "rad/s" if turns else "m/s"
        notes.append(f"{joint.velocity:g} {unit}, as in the URDF, would not close it in {CLOSING_TIME:.2f} s")
    return effort, velocity, tuple(notes)
