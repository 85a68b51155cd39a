"""A godwitd started by a test, and what it says."""
import atexit
import signal
import subprocess
import sys
import threading
import time

PATIENCE_S = 120  # a loaded machine


def fail(reason):
    sys.exit('FAILED: ' + reason)


class Daemon:
    def __init__(self, program, config):
        self.said = []
        self.process = subprocess.Popen([program, '--config', config], stderr=subprocess.PIPE, text=True)
        atexit.register(self.process.kill)  # a test that fails leaves none behind
        threading.Thread(target=lambda: self.said.extend(self.process.stderr), daemon=True).start()

    def says(self, words):
        until = time.monotonic() + PATIENCE_S
        while time.monotonic() < until and self.process.poll() is None:
            if any(words in line for line in self.said):
                return
            time.sleep(0.05)
        fail(f'"{words}" was not said: ' + ''.join(self.said))

    def end(self):
        self.process.send_signal(signal.SIGTERM)
        if self.process.wait(60) != 0:
            fail(''.join(self.said))
