"""godwitd as systemd runs it: started anew as its unit says, watched by its signs of life."""
import os
import pathlib
import re
import signal
import socket
import subprocess
import time


def seconds(text):
    """Of a time as units write it: 100ms, 2, 5s, 1min."""
    number, unit = re.fullmatch(r'([0-9.]+)\s*(ms|s|min)?', text).groups()
    return float(number) * {'ms': 1e-3, None: 1, 's': 1, 'min': 60}[unit]


class Rules:
    """What of a unit decides over starts and ends."""

    def __init__(self, unit):
        keys = dict(re.findall(r'^(\w+)=(.*)$', pathlib.Path(unit).read_text(), re.M))
        assert keys['Restart'] == 'on-failure' and keys['Type'] == 'notify' and keys['StartLimitIntervalSec'] == '0', keys
        self.watchdog_s = seconds(keys['WatchdogSec'])
        self.restart_s = seconds(keys['RestartSec'])
        self.start_s = seconds(keys['TimeoutStartSec'])
        self.stop_s = seconds(keys['TimeoutStopSec'])
        self.restart_codes = {int(x) for x in keys['RestartForceExitStatus'].split()}
        self.final_codes = {int(x) for x in keys['RestartPreventExitStatus'].split()}


class Supervisor:
    """Call look() often. `kills` holds why and when it ended the process itself, `ends` all ends: (time, pid, code)."""

    def __init__(self, command, rules, folder, log_path):
        self.command, self.rules, self.log_path = command, rules, log_path
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        path = str(folder / 'notify')
        self.socket.bind(path)
        self.environment = {**os.environ, 'NOTIFY_SOCKET': path, 'WATCHDOG_USEC': str(int(self.rules.watchdog_s * 1e6))}
        self.process = None
        self.starts, self.kills, self.ends = [], [], []
        self.ready = False
        self.t_sign = self.t_stop = self.t_due = 0.0
        self.start()

    def start(self):
        with open(self.log_path, 'r+b', buffering=0) as log:  # a FIFO opens for both without waiting for its reader
            self.process = subprocess.Popen(self.command, env=self.environment, stderr=log, stdout=subprocess.DEVNULL)
        self.ready, self.t_stop, self.t_due = False, 0.0, 0.0
        self.t_sign = time.monotonic()
        self.starts.append((self.t_sign, self.process.pid))

    @property
    def running(self):
        return self.process is not None

    def hear(self):
        while True:
            try:
                said = self.socket.recv(4096).decode()
            except BlockingIOError:
                return
            for line in said.splitlines():
                self.ready = self.ready or line == 'READY=1'
                if line in ('READY=1', 'WATCHDOG=1'):
                    self.t_sign = time.monotonic()

    def stop(self):
        """As `systemctl restart` does: asked to end, and then started anew."""
        self.process.send_signal(signal.SIGTERM)
        self.t_stop = time.monotonic()

    def kill(self, why, how):
        self.kills.append((time.monotonic(), self.process.pid, why))
        self.process.send_signal(how)

    def look(self, slack):
        """slack: by so much the machine itself was late of late [s]."""
        self.hear()
        now = time.monotonic()
        if self.process is None:
            if now >= self.t_due:
                self.start()
            return
        code = self.process.poll()
        if code is not None:
            self.ends.append((now, self.process.pid, code))
            asked = self.t_stop != 0
            self.process = None
            if code in self.rules.final_codes and not asked:
                raise SystemExit(f'FAILED: godwitd ended with {code}, and systemd would leave it there')
            if code == 0 and not asked:
                raise SystemExit('FAILED: godwitd ended by itself, and systemd would leave it there')
            self.t_due = now + self.rules.restart_s
        elif self.t_stop and now - self.t_stop > self.rules.stop_s + slack:
            self.kill('it did not end when it was told to', signal.SIGKILL)
            self.t_stop = now  # once
        elif not self.t_stop and now - self.t_sign > (self.rules.watchdog_s if self.ready else self.rules.start_s) + slack:
            self.kill('watchdog', signal.SIGABRT)
            self.t_sign = now + 60  # once
