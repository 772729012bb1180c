"""A register-level LSM9DS1 (accelerometer and gyroscope) behind an I2C bus object.

Registers, self-clearing reset, FIFO with FIFO_SRC, output data rate, full-scale clipping and the address wrap 2D to
18 behave as the datasheet says (DocID025715, sections 3.3, 5 and 7). It knows nothing of the driver.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any

from drivers import lsm9ds1_registers as reg
from drivers.mock.chip import MockChip
from drivers.mock.clock import Clock

DEFAULTS = {reg.WHO_AM_I: reg.WHO_AM_I_VALUE, reg.CTRL_REG4: 0x38, reg.CTRL_REG5_XL: 0x38, reg.CTRL_REG8: 0x04}
READ_ONLY = {reg.WHO_AM_I, reg.OUT_TEMP_L, reg.OUT_TEMP_L + 1, reg.STATUS, reg.STATUS_COPY, reg.FIFO_SRC,
             *range(reg.OUT_X_L_G, reg.OUT_Z_H_G + 1), *range(reg.OUT_X_L_XL, reg.OUT_Z_H_XL + 1)}
OUTPUT = [*range(reg.OUT_X_L_G, reg.OUT_Z_H_G + 1), *range(reg.OUT_X_L_XL, reg.OUT_Z_H_XL + 1)]
BYTE_OF = {register: i for i, register in enumerate(OUTPUT)}
RESET_NS = 200_000
RATE_HZ = {code: rate for rate, code in reg.ODR_HZ.items()}
GYRO_RANGE = {code: full for full, code in reg.GYRO_FS_CODE.items()}
ACCEL_RANGE = {code: full for full, code in reg.ACCEL_FS_CODE.items()}


class MockLsm9ds1(MockChip):
    """The chip; `push` hands it what its sensors feel."""

    def __init__(self, clock: Clock, temperature_degc: float = 25.0, address: int = 0x6B, **wire: Any) -> None:
        super().__init__(clock, address, **wire)
        self.temperature_degc = temperature_degc
        self.self_test_dps, self.self_test_mg = 500.0, 400.0
        """What the self-test moves the readings by; zero for a broken chip."""
        self._power_up()

    # -- the world's side ----------------------------------------------------------------------------------

    @property
    def rate_hz(self) -> float:
        """Nominal output data rate of both sensors [Hz]; 0 while powered down."""
        return RATE_HZ.get(self._registers[reg.CTRL_REG1_G] >> 5, 0.0)

    @property
    def ranges(self) -> tuple[int, int]:
        """(gyro [dps], accelerometer [g]) full scale."""
        return (GYRO_RANGE.get(self._registers[reg.CTRL_REG1_G] >> 3 & 3, 245),
                ACCEL_RANGE[self._registers[reg.CTRL_REG6_XL] >> 3 & 3])

    @property
    def cutoffs_hz(self) -> tuple[float, float]:
        """(gyro, accelerometer) -3 dB points of its low passes at this rate."""
        return reg.GYRO_CUTOFF_HZ[self.rate_hz], reg.ACCEL_CUTOFF_HZ[self.rate_hz]

    def push(self, raw: Sequence[int]) -> None:
        """A new sample: gyro x y z, accelerometer x y z [LSB], already clipped to int16."""
        data = b"".join(int(v).to_bytes(2, "little", signed=True) for v in self._deflected(raw))
        self._status = reg.GDA | reg.XLDA
        if self._fifo_mode == 0:
            self._output = data
            return
        if len(self._fifo) == reg.FIFO_DEPTH:
            if self._fifo_mode != reg.FIFO_CONTINUOUS >> 5:
                return  # FIFO mode proper stops when full
            self._overrun = True
            self._fifo.popleft()
        self._fifo.append(data)

    def _deflected(self, raw: Sequence[int]) -> Sequence[int]:
        """The sample with what a self-test that is on adds to it, clipped."""
        on = self._registers[reg.CTRL_REG10]
        if not on:
            return raw
        gyro_range, accel_range = self.ranges
        gyro = self.self_test_dps * 1e3 / reg.GYRO_MDPS_PER_LSB[gyro_range] if on & reg.ST_G else 0.0
        accel = self.self_test_mg / reg.ACCEL_MG_PER_LSB[accel_range] if on & reg.ST_XL else 0.0
        return [max(-32768, min(32767, v + round(added))) for v, added in zip(raw, [gyro] * 3 + [accel] * 3)]

    @property
    def streaming(self) -> bool:
        """Both sensors run into the FIFO."""
        return bool(self.rate_hz and self._fifo_mode)

    @property
    def level(self) -> int:
        """Unread samples in the FIFO."""
        return len(self._fifo)

    def mark_overrun(self) -> None:
        """Mark older samples as overwritten."""
        self._overrun = True

    def brown_out(self) -> None:
        """Supply dips: registers return to their defaults, as after power-up."""
        with self._lock:
            self._power_up()

    # -- the chip ------------------------------------------------------------------------------------------

    def _power_up(self) -> None:
        self._registers = bytearray(128)
        for register, value in DEFAULTS.items():
            self._registers[register] = value
        self._fifo: deque[bytes] = deque()
        self._output = bytes(reg.SAMPLE_BYTES)
        self._overrun = False
        self._status = 0
        self._reset_until: int | None = None

    @property
    def _fifo_mode(self) -> int:
        on = self._registers[reg.CTRL_REG9] & reg.FIFO_EN
        return self._registers[reg.FIFO_CTRL] >> 5 if on else 0

    def receive(self, register: int, data: bytes) -> None:
        self._pointer = register & 0x7F
        for value in data:
            self._store(self._pointer, value)
            self._pointer = self._following(self._pointer)

    def read(self, register: int, count: int) -> bytes:
        return bytes(self._next_byte() for _ in range(count))

    def _store(self, register: int, value: int) -> None:
        if register in READ_ONLY:
            return
        if register == reg.CTRL_REG8 and value & (reg.SW_RESET | reg.BOOT):
            self._power_up()
            self._registers[reg.CTRL_REG8] |= value & (reg.SW_RESET | reg.BOOT)
            self._reset_until = self._clock.now_ns() + RESET_NS
            return
        self._registers[register] = value
        if register == reg.CTRL_REG1_G and value >> 5:  # the gyro's rate becomes the accelerometer's
            accel = self._registers[reg.CTRL_REG6_XL]
            self._registers[reg.CTRL_REG6_XL] = (accel & 0x1F) | (value & 0xE0)
        if self._fifo_mode == 0:
            self._fifo.clear()
            self._overrun = False

    def _next_byte(self) -> int:
        register = self._pointer
        self._pointer = self._following(register)
        self._finish_reset()
        if register in BYTE_OF:
            return self._output_byte(register)
        if register == reg.FIFO_SRC:
            return self._fifo_source()
        if register in (reg.STATUS, reg.STATUS_COPY):
            return self._status | reg.TDA
        if register in (reg.OUT_TEMP_L, reg.OUT_TEMP_L + 1):
            lsb = round((self.temperature_degc - reg.TEMPERATURE_ZERO_DEGC) * reg.TEMPERATURE_LSB_PER_DEGC)
            return lsb.to_bytes(2, "little", signed=True)[register - reg.OUT_TEMP_L]
        return self._registers[register]

    def _following(self, register: int) -> int:
        """Next address: outputs jump 1D to 28 and wrap 2D to 18 while both sensors run (section 3.3)."""
        if not self._registers[reg.CTRL_REG8] & reg.IF_ADD_INC:
            return register
        if self.streaming:
            if register == reg.OUT_Z_H_G:
                return reg.OUT_X_L_XL
            if register == reg.OUT_Z_H_XL:
                return reg.OUT_X_L_G
        return (register + 1) & 0x7F

    def _output_byte(self, register: int) -> int:
        if self._fifo:
            self._output = self._fifo[0]
        value = self._output[BYTE_OF[register]]
        if register == reg.OUT_Z_H_G:
            self._status &= ~reg.GDA
        if register == reg.OUT_Z_H_XL:  # a whole set was read: the FIFO moves on
            if self._fifo:
                self._fifo.popleft()
            self._overrun = False
            self._status &= ~reg.XLDA
        return value

    def _fifo_source(self) -> int:
        level = len(self._fifo)
        threshold = self._registers[reg.FIFO_CTRL] & 0x1F
        return ((reg.FIFO_FTH if level >= threshold else 0) | (reg.FIFO_OVRN if self._overrun else 0) | level)

    def _finish_reset(self) -> None:
        if self._reset_until is not None and self._clock.now_ns() >= self._reset_until:
            self._registers[reg.CTRL_REG8] &= ~(reg.SW_RESET | reg.BOOT) & 0xFF
            self._reset_until = None


