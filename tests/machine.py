"""How late this machine is: a program beside the test that sleeps and computes in turn and tells what became of it."""
import subprocess
import sys
import threading
import time

NAP_S, WORK_S = 0.02, 0.004
PROGRAM = '''
import sys, time
while True:
    begin = time.monotonic()
    time.sleep(%r)
    late = time.monotonic() - begin - %r
    wall, cpu = time.monotonic(), time.thread_time()
    while time.thread_time() - cpu < %r:
        pass
    sys.stdout.write("%%.6f %%.6f %%.6f\\n" %% (begin, late, time.monotonic() - wall))
    sys.stdout.flush()
''' % (NAP_S, NAP_S, WORK_S)


class Machine(threading.Thread):
    """Of the newest seconds: `stall`, the longest time in which the control program should have run and did not, and
    `slowness`, how many times as long as alone its work took."""

    KEPT_S = 30

    def __init__(self):
        super().__init__(daemon=True)
        self.program = subprocess.Popen([sys.executable, '-c', PROGRAM], stdout=subprocess.PIPE, text=True)
        self.measured = []  # (t, late, took)
        self.start()

    def run(self):
        for line in self.program.stdout:
            t, late, took = map(float, line.split())
            self.measured.append((t, late, took))
            while self.measured[0][0] < t - self.KEPT_S:
                self.measured.pop(0)

    def since(self, t):
        return [m for m in list(self.measured) if m[0] >= t - 0.2]

    def stall(self, t):
        """Since t. Includes the time since the control program was heard last: it may be waiting at this moment."""
        heard = self.measured[-1] if self.measured else (time.monotonic(), 0, 0)
        silent = time.monotonic() - heard[0] - heard[1] - heard[2] - NAP_S - WORK_S
        return max([silent, 0.0] + [max(late, took - WORK_S) for _, late, took in self.since(t)])

    def slowness(self, t):
        taken = [took for _, _, took in self.since(t)]
        return max(1.0, sum(taken) / (len(taken) * WORK_S)) if taken else 1.0

    def close(self):
        self.program.kill()
        self.program.wait()


class Stalls:
    """Of a `with`: how long the machine itself stood at most. Limits in time are longer by that."""

    def __enter__(self):
        self.machine, self.t_begin = Machine(), time.monotonic()
        return self

    def __exit__(self, *_):
        self.s = self.machine.stall(self.t_begin)
        self.machine.close()
        print("      the machine stood for %.0f ms at most" % (1e3 * self.s))
