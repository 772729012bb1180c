"""Hide an effect of one's own in simulated runs, and see a diagnosis find it: python docs/own_effect.py

Needs the worked example `hose_pull` installed as docs/effect.md says.
"""

from dataclasses import replace
from pathlib import Path
from tempfile import mkdtemp

from msgspec import structs

from experiments.models.schema import EffectValue
from legid import diagnose, fit, load_rig, model, multisine, record, simulate

folder = Path(mkdtemp(prefix="legid-"))
rig_file = folder / "rig.toml"
rig_file.write_text("""
[mechanism]
model = "leg2"
actuated = [2]
[imu]
lever_arm_m = 0.2
[motor]
gear_ratio = 50.0
""")
rig = load_rig(rig_file)

# A nominal model: here of the emulated leg, otherwise load_model("model.json").
first = record(rig_file, multisine(seed=0, duration_s=6.0, peak_nm=0.7), folder / "run.mcap", emulate="none").run
nominal = model(fit([first], rig), [first], rig)

# The same model with a hose at its knee, and four runs of that, with the model's own noise.
hose = EffectValue(name="hose_pull", joint=2, sizes={"pull": 0.1}, shapes={"width": 0.3})
hosed = structs.replace(nominal, effects=(hose,), reach=((-1.0, 1.0), (-1.0, 1.0)), gear_ratio=50.0)
plans = [multisine(seed=k, duration_s=6.0, peak_nm=0.7) for k in range(4)]
runs = [replace(simulate(hosed, plan, noise_seed=k), name=f"run{k}") for k, plan in enumerate(plans)]

found = diagnose(runs, rig)
print(found.verdict, "-", found.sentence)
