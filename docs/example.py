"""From an emulated leg to a model that knows what was wrong with it, in Python. Run it: python docs/example.py"""

# %% A rig, as rig.toml describes it. A key that is absent has its default.
from pathlib import Path
from tempfile import mkdtemp

import legid

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
[limits]
torque_nm = 1.0
""")

# %% Four runs of six seconds, each with other phases, on a leg that hides a spring at its knee.
runs = []
for k in range(4):
    plan = legid.multisine(seed=k, duration_s=6.0, peak_nm=0.7)
    recording = legid.record(rig_file, plan, folder / f"run{k + 1}.mcap", emulate="joint_stiffness", seed=k)
    runs.append(recording.run)
print(f"{runs[0].name}: {len(runs[0])} samples at {runs[0].rate_hz:g} Hz, columns {', '.join(runs[0].columns)}")

# %% The nominal model: beta with its 95 % intervals, from the first three. A run knows the rig it was loaded with.
result = legid.fit(runs[:3])
for parameter, value, (low, high) in zip(result.mechanism.parameters, result.beta, result.ci95()):
    print(f"{parameter.name}  {value:8.4f}  [{low:8.4f}, {high:8.4f}]  {parameter.unit:10} {parameter.meaning}")
nominal = legid.model(result)

# %% A free run of the fourth, which the fit has not seen: started once, then driven by the measured torque alone.
(before,) = legid.validate(nominal, runs[3])
print(f"nominal model: rms error of the knee {before.rmse['q2_rad']:.4f} rad")

# %% What does it get wrong? The diagnosis chooses test runs, found.confirm_runs, and judges by them.
found = legid.diagnose(runs)
print(found.verdict, "-", found.sentence)
extended = legid.model(found)
(after,) = legid.validate(extended, runs[3])
print(f"extended model: rms error of the knee {after.rmse['q2_rad']:.4f} rad")

# %% Results draw themselves, and give tables: result.to_frame(), found.to_frame("candidates").
found.plot().savefig(folder / "diagnosis.png")

# %% A model is a file of numbers, and runs any plan.
legid.save_model(extended, folder / "extended.json")
what_if = legid.simulate(extended, legid.multisine(seed=9, duration_s=6.0, peak_nm=0.3), noise_seed=1)
print(f"{what_if.name}: the knee would move from {what_if['q2_rad'].min():.2f} to {what_if['q2_rad'].max():.2f} rad")
