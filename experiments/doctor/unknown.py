"""`largest_unknown`: which tolerance of a rig moves its parameters most, before any run."""

from __future__ import annotations

from daq import Rig
from experiments.doctor.check import Check

GRAVITY_MPS2 = 9.81
REMEDIES = {
    "torque_gain": ("the torque constant", "hang a known weight: legid calibrate shunt --weight"),
    "imu_lever_arm": ("the IMU's distance from the pivot", "legid calibrate mount, or measure it"),
    "imu_misalignment": ("the IMU's tilt on its link", "legid calibrate mount"),
    "accelerometer_bias": ("the accelerometer's zero", "legid calibrate imu"),
    "gyro_scale": ("the gyro's scale", "legid calibrate imu-encoder"),
    "encoder_offset": ("the encoder's zero", "legid calibrate encoder"),
}
"""Effect -> what is unknown, and what shows it."""


def largest_unknown(rig: Rig) -> Check:
    """A line with the largest tolerance, as a share of what it is of, and what would show it.

    A share moves parameters by about as much: the torque constant moves all in proportion.
    """
    from estimator.score import default_tolerances

    stated = rig.tolerances
    lever_m = max(abs(imu.lever_arm_m) for imu in rig.imus)
    of = {"torque_gain": 1.0, "imu_misalignment": 1.0, "accelerometer_bias": GRAVITY_MPS2, "gyro_scale": 1.0,
          "encoder_offset": 1.0} | ({"imu_lever_arm": lever_m} if lever_m > 0.0 else {})
    known = {} if "none" in stated else default_tolerances()
    shares = {name: max(stated.get(name, known.get(name, (0.0,))), default=0.0) / scale for name, scale in of.items()}
    name = max(shares, key=lambda one: shares[one])
    if not shares[name]:
        return Check("tolerances", "ok", "none: [tolerance] none = true, so intervals hold noise and scatter alone")
    what, remedy = REMEDIES[name]
    source = "as stated" if name in stated else "by default"
    return Check("tolerances", "ok", f"the largest unknown is {what}, {100.0 * shares[name]:.2g} % (1 sigma, "
                 f"{source}): {remedy}")
