"""LSM9DS1 accelerometer and gyroscope: register map, codes and scales (ST DocID025715, sections 6 and 7)."""

from __future__ import annotations

WHO_AM_I = 0x0F
WHO_AM_I_VALUE = 0x68
CTRL_REG1_G = 0x10
CTRL_REG2_G = 0x11
CTRL_REG3_G = 0x12
OUT_TEMP_L = 0x15
STATUS = 0x17
OUT_X_L_G = 0x18
OUT_Z_H_G = 0x1D
CTRL_REG4 = 0x1E
CTRL_REG5_XL = 0x1F
CTRL_REG6_XL = 0x20
CTRL_REG7_XL = 0x21
CTRL_REG8 = 0x22
CTRL_REG9 = 0x23
CTRL_REG10 = 0x24
STATUS_COPY = 0x27
OUT_X_L_XL = 0x28
OUT_Z_H_XL = 0x2D
FIFO_CTRL = 0x2E
FIFO_SRC = 0x2F

BOOT, BDU, IF_ADD_INC, SW_RESET = 0x80, 0x40, 0x04, 0x01
"""Bits of CTRL_REG8."""
FIFO_EN = 0x02
"""Bit of CTRL_REG9."""
ST_G, ST_XL = 0x04, 0x01
"""Bits of CTRL_REG10: self-test on."""
TDA, GDA, XLDA = 0x04, 0x02, 0x01
"""Bits of STATUS: new temperature, gyro, accelerometer reading."""
FIFO_BYPASS, FIFO_CONTINUOUS = 0x00, 0xC0
"""Modes, FIFO_CTRL[7:5]."""
FIFO_FTH, FIFO_OVRN, FIFO_FSS = 0x80, 0x40, 0x3F
"""Fields of FIFO_SRC."""
FIFO_DEPTH = 32
SAMPLE_BYTES = 12
"""Gyro x y z then accelerometer x y z, two bytes each, low byte first."""

ODR_HZ: dict[float, int] = {14.9: 1, 59.5: 2, 119.0: 3, 238.0: 4, 476.0: 5, 952.0: 6}
"""Rate of both sensors to the code in CTRL_REG1_G[7:5] (table 46)."""
GYRO_CUTOFF_HZ: dict[float, float] = {14.9: 5.0, 59.5: 19.0, 119.0: 38.0, 238.0: 76.0, 476.0: 100.0, 952.0: 100.0}
"""-3 dB point of LPF1, from which CTRL_REG2_G = 0 takes the gyro (table 46)."""
ACCEL_CUTOFF_HZ: dict[float, float] = {14.9: 408.0, 59.5: 408.0, 119.0: 50.0, 238.0: 105.0, 476.0: 211.0, 952.0: 408.0}
"""-3 dB point of the accelerometer's anti-alias filter as its rate selects it: CTRL_REG6_XL with BW_SCAL_ODR = 0."""
GYRO_FS_CODE: dict[int, int] = {245: 0b00, 500: 0b01, 2000: 0b11}
"""Full scale [dps] to CTRL_REG1_G[4:3]; 10 is not allowed."""
ACCEL_FS_CODE: dict[int, int] = {2: 0b00, 16: 0b01, 4: 0b10, 8: 0b11}
"""Full scale [g] to CTRL_REG6_XL[4:3]; the order is the chip's."""
GYRO_MDPS_PER_LSB: dict[int, float] = {245: 8.75, 500: 17.5, 2000: 70.0}
ACCEL_MG_PER_LSB: dict[int, float] = {2: 0.061, 4: 0.122, 8: 0.244, 16: 0.732}
"""Table 3. Not full scale / 32768: 16 g really is 0.732."""
TEMPERATURE_LSB_PER_DEGC = 16.0
TEMPERATURE_ZERO_DEGC = 25.0
STANDARD_GRAVITY = 9.80665
"""The g of the accelerometer's scale [m/s2]; never the gravity of the place."""
SETTLE_SAMPLES = 20
"""Samples to throw away after power-up or a rate change: gyro 2-8 (LPF1) or 13-18 (LPF2), accelerometer 0-14 (the
datasheet's turn-on tables), and the first after a FIFO mode change."""
