#!/usr/bin/env python3
"""How a process ended is told to whoever started it, also while one of its threads stands: a supervisor's rules hang on it."""
import os
import signal
import subprocess
import sys
import time

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from one_thread import StoppedThread  # noqa: E402

# A second thread, and both sleep.
SLEEPER = 'import threading, time; t = threading.Thread(target=time.sleep, args=(60,)); t.start(); print(flush=True); t.join()'
LIMIT_S = 30


def ends_with(which, how):
    """The exit code that the parent hears after the signal, while the first or the second thread stands."""
    process = subprocess.Popen([sys.executable, '-c', SLEEPER], stdout=subprocess.PIPE)
    process.stdout.readline()
    tids = sorted(int(t) for t in os.listdir(f'/proc/{process.pid}/task'))
    stopped = StoppedThread(tids[which])
    process.send_signal(how)
    give_up = time.monotonic() + LIMIT_S
    while time.monotonic() < give_up:
        stopped.look()
        if process.poll() is not None:
            break
        time.sleep(0.01)
    stopped.release()
    process.kill()
    return process.wait()


def main():
    failed = 0
    for which, name in ((0, 'first'), (1, 'second')):
        for how in (signal.SIGABRT, signal.SIGKILL):
            code = ends_with(which, how)
            failed += code != -how
            print(('ok    ' if code == -how else 'FAIL  ') + f'{how.name} while the {name} thread stands: {code}')
    return 1 if failed else 0


if __name__ == '__main__':
    sys.exit(main())
