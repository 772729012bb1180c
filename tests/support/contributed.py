"""What a newcomer's five files do once they are in the packages; run by test_contributing in a copy of these."""

import select
import socket
import sys
import threading
from pathlib import Path

import numpy as np
from estimator.model.crane import crane  # type: ignore[import-not-found]
from msgspec import structs

from daq import Dataset, parse_rig
from daq.recording import Plan
from daq.runs import write_csv
from drivers import Drive, State
from drivers.mock import FirmwareSettings, MockRig, PtyServer, RealClock
from estimator import FitOptions, fit
from estimator.effects import library
from estimator.model import leg2, simulate
from experiments.models import EffectValue, load_model
from experiments.rig.devices import connect
from experiments.workflows import simulate_run
from tests.support.leg_on_a_link import poll_until
from tests.support.models import LEG, write_model
from tests.support.shell import typed
from tests.support.still_plant import StillPlant

RIG = "[mechanism]\nmodel = \"leg2\"\nactuated = [2]\n"
BETA = [0.14, 0.03, 0.05, 0.5, 0.15, 0.05, 0.03, 0.001, 0.001]


def effect(folder: Path) -> None:
    """Listed, offered for both joints, and in a simulation the hip rests where its torque balances gravity's."""
    typed("effects")
    assert {"wind@1", "wind@2"} <= {e.key for e in library(leg2(lever_arm=0.2), True)[0]}
    plain = load_model(write_model(folder / "leg.json", BETA, LEG))
    windy = structs.replace(plain, effects=(EffectValue(name="wind", joint=1, sizes={"push": 0.5}),),
                            reach=((-1.0, 1.0), (-1.0, 1.0)))
    calm = Plan(np.arange(0.0, 40.0, 0.02), np.zeros(2000))
    q1, q2 = (simulate_run(windy, calm, "calm").columns[name][-1] for name in ("q1_rad", "q2_rad"))
    needed = 9.81 * (0.5 * np.sin(q1) + 0.15 * np.sin(q1 + q2))
    assert q1 > 0.05 and abs(needed - 0.5 * np.cos(q1)) < 0.005, (q1, q2, needed)


def mechanism(folder: Path) -> None:
    """Fitted from a motion of its own, with noise, from Python and by a rig file that names it."""
    m, rng, time = crane(), np.random.default_rng(2), np.arange(1500) / 100.0
    beta = np.array([1.2, 0.3, 0.35, 2.0, 0.6, 0.2, 0.02, 0.1, 0.01])
    tau = np.column_stack([4.0 * np.sin(2.1 * time) + 3.0 * np.sin(5.3 * time + 1.0), np.zeros(time.size)])
    q, _, _ = simulate(m, beta, np.zeros(2), np.zeros(2), tau, 0.01)
    assert np.isfinite(q).all() and np.abs(q[:, 1]).max() > 0.1
    columns = {f"q{j + 1}_rad": q[:, j] + 2e-4 * rng.normal(size=time.size) for j in (0, 1)}
    run = Dataset("crane", 100.0, time, columns | {"tau1_nm": tau[:, 0] + 0.02 * rng.normal(size=time.size)})
    found = fit([run], m, FitOptions(sensors="encoder"))
    assert found.converged and not found.undetermined
    assert np.abs(found.beta[:5] / beta[:5] - 1.0).max() < 0.03, found.beta

    rig, model = folder / "crane.toml", folder / "crane.json"
    write_csv(run, folder / "crane.csv")
    for name, status in (("crane", 0), ("crame", 2)):
        rig.write_text(f'[mechanism]\nmodel = "{name}"\nactuated = [1]\n')
        typed("fit", folder / "crane.csv", "--rig", rig, "--model-out", model, status=status)
    saved = load_model(model)
    assert saved.mechanism.model == "crane" and np.abs(np.array(saved.beta)[:5] / beta[:5] - 1.0).max() < 0.03


def device() -> None:
    """The emulated controller behind a socket shakes hands, arms, and is off again when the driver lets go."""
    clock = RealClock()
    rig = MockRig(StillPlant(), clock, firmware=FirmwareSettings())
    with socket.create_server(("127.0.0.1", 0)) as server:
        ended = threading.Event()

        def serve() -> None:
            peer, _ = server.accept()
            with peer:
                while not ended.is_set():
                    if select.select([peer], [], [], 0.001)[0]:
                        data = peer.recv(65536)
                        if not data:
                            return
                        rig.firmware.receive(data, clock.now_ns())
                    peer.sendall(b"".join(frame for _, frame in rig.firmware.transmit(clock.now_ns())))

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        port = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        named = parse_rig(f"{RIG}[devices.controller]\nport = \"{port}\"\n").devices
        assert named.controller is not None
        controller = connect(named.controller)
        try:
            assert controller.open().boot_id == rig.firmware.boot_id
            controller.arm(100)
            until(controller, State.ARMED)
        finally:
            controller.close()
            thread.join(5.0)
            ended.set()
    assert rig.firmware.drive.state == State.DISARMED and rig.firmware.drive.torque_nm == 0.0


class Hobby:
    """The far end of the drive's line, as its protocol says."""

    def __init__(self) -> None:
        self.state, self.torque, self.fed_s, self.watchdog_s, self.line = 0, 0.0, 0.0, 1.0, b""
        self.out: list[tuple[int, bytes]] = []
        self.post = self.receive

    def receive(self, data: bytes, t_ns: int) -> None:
        *lines, self.line = (self.line + data).split(b"\n")
        for line in lines:
            word, *rest = line.decode().split()
            if word == "s":
                self.state, self.torque = 0, 0.0
            elif word == "t" and self.state != 2:
                self.state, self.fed_s = 1, t_ns * 1e-9
                self.torque, self.watchdog_s = float(rest[0]), float(rest[1]) * 1e-3
            elif word == "g":
                self.out.append((t_ns, f"{self.state} 12.5 {self.torque} 24.0 30.0 {self.torque}\n".encode()))

    def transmit(self, until_ns: int) -> list[tuple[int, bytes]]:
        if self.state == 1 and until_ns * 1e-9 - self.fed_s > self.watchdog_s:
            self.state, self.torque = 2, 0.0
        out, self.out = self.out, []
        return out


def drive() -> None:
    """It is found by its name, turns with gear and sign, latches its watchdog, and is off when the driver lets go."""
    far = Hobby()
    with PtyServer(far) as server:
        rig = parse_rig(f"{RIG}[motor]\ngear_ratio = 50.0\nsign = -1\n[devices.controller]\nkind = \"ascii\"\n"
                        f"port = \"{server.path}\"\n")
        assert rig.devices.controller is not None
        with connect(rig.devices.controller, rig) as controller:
            assert controller.open().gear_ratio == 50.0
            controller.arm(50)
            controller.command(1.0)
            until(controller, State.ARMED)
            seen = controller.telemetry
            assert seen is not None and abs(seen.torque_cmd_nm - 1.0) < 1e-4 and abs(far.torque + 0.02) < 1e-9
            assert abs(seen.knee_rad + 12.5 * 2.0 * np.pi / 50.0) < 1e-9
            until(controller, State.FAULT)
            assert far.torque == 0.0
            controller.command(1.0)  # behind a fault: goes nowhere
            controller.clear_faults()
            until(controller, State.DISARMED)
            controller.arm(1000)
            controller.command(1.0)
            until(controller, State.ARMED)
    assert far.state == 0 and far.torque == 0.0


def until(controller: Drive, state: State) -> None:
    poll_until(controller, lambda _: controller.telemetry and controller.telemetry.state == state)


def command(folder: Path) -> None:
    """Its line is in the help, and it says how long a run is."""
    (folder / "rig.toml").write_text('[mechanism]\nmodel = "joint1"\nactuated = [1]\n')
    rows = [f"{k / 100.0},{np.sin(k / 20.0)},0.1" for k in range(201)]
    (folder / "run.csv").write_text("\n".join(["time_s,q1_rad,tau1_nm", *rows]) + "\n")
    typed("length", folder / "run.csv", "--rig", folder / "rig.toml")


if __name__ == "__main__":
    here = Path(sys.argv[1])
    effect(here)
    mechanism(here)
    device()
    drive()
    command(here)
