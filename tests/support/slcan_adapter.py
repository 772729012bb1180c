"""The far end of a serial CAN adapter (Lawicel protocol) on a pseudo-terminal."""

import os
import threading
import time
import tty


class SlcanAdapter:
    """`heard` has what came; a test lets it `say` something."""

    def __init__(self) -> None:
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        os.set_blocking(self.master, False)
        self.path, self.heard, self.running = os.ttyname(self.slave), "", True
        self.thread = threading.Thread(target=self.listen, daemon=True)
        self.thread.start()

    def listen(self) -> None:
        while self.running:
            try:
                self.heard += os.read(self.master, 4096).decode()
            except BlockingIOError:
                time.sleep(0.0005)
            self.turn()

    def turn(self) -> None:
        """Whenever it has listened."""

    def say(self, text: str) -> None:
        os.write(self.master, text.encode())

    def close(self) -> None:
        self.running = False
        self.thread.join()
        os.close(self.master)
        os.close(self.slave)
