"""A register-level magnetometer of the LSM9DS1."""

from drivers import lsm9ds1_mag as mag
from drivers.mock.chip import MockChip
from drivers.mock.clock import Clock

DEFAULTS = {mag.WHO_AM_I: mag.WHO_AM_I_VALUE, mag.CTRL_REG1: 0x10, mag.CTRL_REG3: 0x03}
RESET_NS = 200_000
RATE_HZ = {code: rate for rate, code in mag.MAG_ODR_HZ.items()}
RANGE = {code: full for full, code in mag.FS_CODE.items()}
POWER_DOWN = 0x02


class MockMagnetometer(MockChip):
    """The chip: a field that a test sets shows up at the output data rate, and moves under self-test."""

    def __init__(self, clock: Clock) -> None:
        super().__init__(clock, 0x1E)
        self.field_gauss = (0.2, 0.0, 0.4)
        """Field in the magnetometer's own axes."""
        self.self_test_mgauss = (2000.0, 2000.0, 500.0)
        """What the self-test adds; zeros for a broken chip."""
        self._power_up()

    def _power_up(self) -> None:
        self._registers = bytearray(128)
        for register, value in DEFAULTS.items():
            self._registers[register] = value
        self._reset_until: int | None = None
        self._started_ns, self._seen = self._clock.now_ns(), 0

    def _count(self) -> int:
        """Readings made since it was started."""
        off = self._registers[mag.CTRL_REG3] & POWER_DOWN
        rate_hz = 0.0 if off else RATE_HZ[self._registers[mag.CTRL_REG1] >> 2 & 7]
        return int((self._clock.now_ns() - self._started_ns) * 1e-9 * rate_hz)

    def receive(self, register: int, data: bytes) -> None:
        self._pointer, self._increment = register & 0x7F, bool(register & mag.AUTO_INCREMENT)
        for value in data:
            self._store(self._pointer, value)
            self._pointer += self._increment

    def read(self, register: int, count: int) -> bytes:
        return bytes(self._next_byte() for _ in range(count))

    def _store(self, register: int, value: int) -> None:
        if register == mag.WHO_AM_I or mag.STATUS <= register < mag.OUT_X_L + 6:
            return
        if register == mag.CTRL_REG2 and value & mag.SOFT_RESET:
            self._power_up()
            self._registers[mag.CTRL_REG2] |= mag.SOFT_RESET
            self._reset_until = self._clock.now_ns() + RESET_NS
            return
        self._registers[register] = value
        if register in (mag.CTRL_REG1, mag.CTRL_REG3):
            self._started_ns, self._seen = self._clock.now_ns(), 0

    def _next_byte(self) -> int:
        register = self._pointer
        self._pointer += self._increment
        if self._reset_until is not None and self._clock.now_ns() >= self._reset_until:
            self._registers[mag.CTRL_REG2] &= ~mag.SOFT_RESET & 0xFF
            self._reset_until = None
        if register == mag.STATUS:
            fresh = self._count() - self._seen
            return (mag.DATA_READY if fresh else 0) | (mag.OVERRUN if fresh > 1 else 0)
        if mag.OUT_X_L <= register < mag.OUT_X_L + 6:
            self._seen = self._count()
            return self._output()[register - mag.OUT_X_L]
        return self._registers[register]

    def _output(self) -> bytes:
        on = self._registers[mag.CTRL_REG1] & mag.SELF_TEST
        per_lsb = mag.MGAUSS_PER_LSB[RANGE[self._registers[mag.CTRL_REG2] >> 5 & 3]]
        words = [round((1e3 * field + (moved if on else 0.0)) / per_lsb)
                 for field, moved in zip(self.field_gauss, self.self_test_mgauss)]
        return b"".join(max(-32768, min(32767, w)).to_bytes(2, "little", signed=True) for w in words)
