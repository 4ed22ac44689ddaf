"""The search for a missing effect, from Python: hide one in the second robot, look for it, read the answer as data.

    python examples/search.py

The logs come from an independently written robot (synthetic), so that the model that is questioned has not made them. Here seven
effects of the catalogue are in question and 64 null runs are made; `fishmj gap find` asks for all, with 96.
"""

from fishmj import effects
from fishmj.gap.laboratory.virtual_robot import generate
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.null.null_runs import SimulatedNull
from fishmj.gap.workflow import investigate

SWIMS = ("gait_fast", "drift_north", "turn_left", "tow_oblique")
ASKED = ("command_latency", "joint_sensor_delay", "coulomb_friction", "servo_gain", "steady_current", "camera_scale", "yaw_drag")
TRUE = 0.12  # N m of dry friction in every joint

if __name__ == "__main__":
    logs = generate({"coulomb_friction": {"torque": TRUE}}, SWIMS, 11)
    model = SwimmingFish(catalogue=[effects.get(name) for name in ASKED])
    verdict = investigate(model, logs, null=SimulatedNull(runs=64), say=print).verdict
    gaps = f"{verdict.gap_before:.1f} to {verdict.gap_after:.1f} (up to {verdict.gap_allowed:g} agrees)"
    print(f"\n{verdict.answer}; the gap goes from {gaps}")
    for effect in verdict.effects:
        for name, found in effect.parameters.items():
            print(f"{effect.name} {name} = {found.value:.3g} {found.unit} ({found.low:.3g} to {found.high:.3g})")
    assert verdict.answer == "NAMED" and verdict.effects[0].name == "coulomb_friction"
    assert abs(verdict.effects[0].parameters["torque"].value / TRUE - 1) < 0.1
