"""Write logs of a simulated knee behind a position loop: python docs/servo_log.py FOLDER

A link of 0.02 kg m^2 and 0.05 kg m hangs from a servo of 4 N m/rad that follows a command. Every file log1.csv to
log6.csv has the columns that a hobbyist would write: time, knee_cmd_deg, knee_deg.
"""

import sys
from pathlib import Path

import numpy as np

INERTIA, MOMENT, VISCOUS, COULOMB, GAIN = 0.02, 0.05, 0.03, 0.02, 4.0
STEP_S, EVERY, SECONDS = 1e-3, 10, 12.0

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
time = np.arange(0.0, SECONDS, STEP_S)
for number in range(1, 7):
    rng = np.random.default_rng(number)
    phases = rng.uniform(0.0, 2.0 * np.pi, 3)
    waves = [a * np.sin(2.0 * np.pi * f * time + p) for a, f, p in zip((0.6, 0.4, 0.25), (0.31, 0.83, 1.9), phases)]
    command = np.sum(waves, axis=0)
    angle, speed, rows = float(command[0]), 0.0, []
    for k, (now, wanted) in enumerate(zip(time, command)):
        read = np.round(angle * 4096 / (2.0 * np.pi)) * 2.0 * np.pi / 4096  # an encoder of 12 bits
        if k % EVERY == 0:
            rows.append((now, np.degrees(wanted), np.degrees(read)))
        torque = GAIN * (wanted - read)
        torque -= VISCOUS * speed + COULOMB * np.tanh(speed / 0.01) + 9.81 * MOMENT * np.sin(angle)
        speed += STEP_S * torque / INERTIA
        angle += STEP_S * speed
    np.savetxt(folder / f"log{number}.csv", rows, delimiter=",", comments="", fmt="%.6f",
               header="time,knee_cmd_deg,knee_deg")
