#!/usr/bin/env python3
"""godwitd in chaos: under a supervisor with its unit's rules single threads are stopped, and disc, log, bus and camera break,
at random; after each fault it is checked that what the node told meanwhile was true:

- never "well" (NodeStatus OK and OPERATIONAL) for more than a second while camera, tracker or link thread stand or no
  picture comes; nor without an ODOMETRY within the last second;
- times in ODOMETRY strictly grow, and no pose counts as one (a camera alone knows no metres);
- back within 5 seconds, by itself or after a start; no other end than those that the supervisor asked for.

    with_peers.sh --bus dronecan,pymavlink chaos_test.py GODWIT GODWITD UNIT [--seconds 60] [--seed N] [--only FAULT]

A control program beside it measures how late the machine itself is; limits are longer by that, and each check says so.
"""
import argparse
import ctypes
import os
import pathlib
import random
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import faults  # noqa: E402
from machine import Machine  # noqa: E402
from supervisor import Rules, Supervisor  # noqa: E402
from told import Told  # noqa: E402  (finds tests/link)
from emulated_autopilot import EmulatedAutopilot, uavcan  # noqa: E402

BACK_S = 5.0
CLONE_NEWNS = 0x00020000


class Log:
    """The reader of godwitd's error stream: a FIFO, which may be left unread and come back."""

    KEPT = 200_000  # bytes of it that are shown after a failure

    def __init__(self, path):
        self.path, self.said, self.reading, self.fd = path, b'', True, -1
        os.mkfifo(path)
        self.open()

    def open(self):
        self.fd = os.open(self.path, os.O_RDONLY | os.O_NONBLOCK)

    def close(self):
        os.close(self.fd)
        self.fd = -1

    def look(self):
        if self.fd < 0 or not self.reading:
            return
        try:
            while part := os.read(self.fd, 65536):
                self.said = (self.said + part)[-self.KEPT:]
        except BlockingIOError:
            pass


class Run:
    def __init__(self, arguments, folder):
        self.failed = 0
        self.bus_is_up, self.flood, self.stopped = True, None, []
        self.recording, self.state = folder / 'recording', folder / 'state'
        subprocess.run([arguments.godwit, 'sim', 'street', '--frames', '60', '--out', self.recording], check=True,
                       stdout=subprocess.DEVNULL)
        listed = [line.split() for line in (self.recording / 'rgb.txt').read_text().splitlines() if line[0] != '#']
        self.pictures = (self.recording / listed[0][1]).parent
        self.state.mkdir()
        subprocess.run(['mount', '-t', 'tmpfs', '-o', 'size=16m', 'none', self.state], check=True)
        config = folder / 'godwit.toml'
        config.write_text(f'[camera]\nsource = "replay"\nsequence = "{self.recording}"\n[can]\nbus = "multicast:0"\n'
                          '[aids]\nattitude = false\n'  # the emulated autopilot's is not the recording's
                          f'[link]\nstate_folder = "{self.state}"\n[live]\nsocket = "{folder}/live"\n')
        self.machine = Machine()
        self.told, self.autopilot = Told(0), EmulatedAutopilot(0)
        self.log = Log(folder / 'log')
        self.supervisor = Supervisor([arguments.godwitd, '--config', config], Rules(arguments.unit), folder, folder / 'log')

    def check(self, good, text):
        print(('ok    ' if good else 'FAIL  ') + text, flush=True)
        self.failed += not good

    def slack(self):
        return self.machine.stall(time.monotonic() - 5)

    def turn(self):
        """Some 30 ms of the world going on."""
        try:
            if self.bus_is_up:
                self.autopilot.spin(0.02)
            if self.flood is not None:
                for _ in range(20):
                    data = self.flood.randbytes(self.flood.randrange(8, 90))
                    self.autopilot.node.can_driver.out.send(data if self.flood.random() < 0.5 else b'\x34\x29' + data)
        except OSError:
            pass  # the bus has just gone
        time.sleep(0.01)
        for thread in self.stopped:
            thread.look()
        self.told.look()
        self.log.look()
        self.supervisor.look(self.slack())

    def save_parameters(self):
        """As a ground station does; whatever the answer, it must do no harm."""
        try:
            self.autopilot.node.request(uavcan.protocol.param.ExecuteOpcode.Request(opcode=0), self.autopilot.source, lambda _: None)
        except OSError:
            pass

    def told_since(self, t):
        return [s for s in self.told.statuses if s[0] >= t]

    def await_well(self, t_end, limit_s):
        """Until the node says that it is well, and poses come, after t_end. True; or False, when that takes too long."""
        while True:
            t_well = next((t for t, well, _ in self.told_since(t_end) if well), None)
            if t_well is not None and any(t >= t_end for t, _, _ in self.told.odometry):
                slowness, stall = self.machine.slowness(t_end), self.machine.stall(t_end)
                return t_well - t_end <= limit_s * slowness + stall, t_well - t_end, slowness, stall
            slowness, stall = self.machine.slowness(t_end), self.machine.stall(t_end)
            if time.monotonic() - t_end > 2 * limit_s * slowness + stall:
                return False, time.monotonic() - t_end, slowness, stall
            self.turn()

    def settle(self):
        """Until no process is about to end: the watchdog's patience may end with the fault itself, when all seems well again."""
        t_killed = None
        while not self.supervisor.running or any(k[1] == self.supervisor.process.pid for k in self.supervisor.kills):
            t_killed = t_killed or time.monotonic()
            self.turn()
        if t_killed is not None:
            good, took, slowness, stall = self.await_well(self.supervisor.starts[-1][0], BACK_S)
            self.check(good, 'started anew after the fault, back after %.1f s (limit %.1f)' % (took, BACK_S * slowness + stall))

    def look_for_lies(self, fault, t_begin, t_end):
        """What was told while a fault was true."""
        stall = self.machine.stall(t_begin)
        if fault.lies_after is not None:
            limit = fault.lies_after + stall
            lies = [s for s in self.told_since(t_begin + limit) if s[0] < t_end and s[1]]
            self.check(not lies, 'never well for more than %.1f s (%.1f and a stall of %.2f s)%s' % (
                limit, fault.lies_after, stall, ': %.2f s after: %s' % (lies[0][0] - t_begin, lies[0][2]) if lies else ''))
        during = [s for s in self.told_since(t_begin + 0.5) if s[0] < t_end]
        if fault.stays_well and len(during) >= 3 and stall < 0.3:
            self.check(any(s[1] for s in during), 'well all the while: it concerns nobody in flight%s' % (
                '' if any(s[1] for s in during) else ': ' + during[-1][2]))

    def look_at_stream(self):
        """Of all that was told since the last call."""
        poses = [t for t, _, _ in self.told.odometry]
        silent = [(t, words) for t, well, words in self.told.statuses
                  if well and t > max(self.t_looked_at, self.t_bus_up + 1) and
                  not any(t - 1 - self.slack() < p <= t for p in poses)]
        self.check(not silent, 'whenever it was well there was an ODOMETRY within the last second' + (
            ': not %.2f s ago (%s)' % (time.monotonic() - silent[0][0], silent[0][1]) if silent else ''))
        starts = [t for t, _ in self.supervisor.starts]
        back = [(a, b) for a, b in zip(self.told.odometry, self.told.odometry[1:])
                if b[1] <= a[1] and not any(a[0] <= s <= b[0] for s in starts)]
        claimed = [o for o in self.told.odometry if o[2] >= 0]
        self.check(not back and not claimed, 'ODOMETRY: times grow, none claims metres%s' % ('' if not back else ': %s' % back[0]))
        self.t_looked_at = time.monotonic()
        # The newest stay: the next fault's statuses are compared with them.
        self.told.odometry = self.told.odometry[-60:]
        self.told.statuses = [s for s in self.told.statuses if s[0] > self.t_looked_at - 5]

    t_looked_at = 0.0
    t_bus_up = 0.0  # nobody hears an ODOMETRY while the bus is down: it has a second from then on

    def one(self, fault, lasts_s):
        pid, kills = self.supervisor.process.pid, len(self.supervisor.kills)
        print('%s, %.1f s' % (fault.name, lasts_s), flush=True)
        t_begin = time.monotonic()
        fault.begin()
        while time.monotonic() - t_begin < lasts_s:
            self.turn()
        t_over = time.monotonic()
        fault.end()
        t_end = time.monotonic()
        # With the process the fault was over, too: what comes then is said by another.
        ended = next((t for t, ended_pid, _ in self.supervisor.ends if ended_pid == pid), None)
        killed = next((t for t, _, why in self.supervisor.kills[kills:]), None)
        if killed is not None:
            print('      ended by the supervisor after %.1f s: %s' % (killed - t_begin, self.supervisor.kills[-1][2]))
        self.told.look()
        self.look_for_lies(fault, t_begin, min(t for t in (t_over, ended, killed) if t is not None))
        good, took, slowness, stall = self.await_well(t_end, BACK_S)
        self.check(good, 'back after %.1f s (limit %.1f: the machine was %.1f times as slow as alone, and stood for %.2f s)' % (
            took, BACK_S * slowness + stall, slowness, stall))
        for t, ended_pid, code in self.supervisor.ends:
            asked = any(k[1] == ended_pid for k in self.supervisor.kills) or isinstance(fault, faults.ToldToEnd)
            if t >= t_begin and not (asked and code in (0, 1, -6, -9)):
                self.check(False, f'it ended with {code}, and nobody had asked')
        self.look_at_stream()


def own_mounts():
    """A view of the file systems of our own, where discs may be full and read-only."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.unshare(CLONE_NEWNS) != 0 or subprocess.run(['mount', '--make-rprivate', '/'], check=False).returncode != 0:
        print('SKIPPED: no mounts of our own can be made here (unshare -m)')
        sys.exit(1 if os.environ.get('CI') == 'true' else 77)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ('godwit', 'godwitd', 'unit'):
        parser.add_argument(name)
    parser.add_argument('--seconds', type=float, default=60)
    parser.add_argument('--seed', type=int, default=int(time.time()) % 1_000_000)
    parser.add_argument('--only', help='faults whose class or name holds this word')
    arguments = parser.parse_args()
    own_mounts()
    print(f'seed {arguments.seed}')
    draw = random.Random(arguments.seed)
    with tempfile.TemporaryDirectory(prefix='godwit_chaos.') as name:
        folder = pathlib.Path(name)
        run = Run(arguments, folder)
        ended = False
        try:
            good, took, slowness, _ = run.await_well(time.monotonic(), 30)
            run.check(good, 'first well after %.1f s (the machine %.1f times as slow as alone)' % (took, slowness))
            begin = time.monotonic()
            count = 0
            kinds, weights = zip(*faults.ALL)
            while time.monotonic() - begin < arguments.seconds and run.failed == 0:
                run.settle()
                fault = draw.choices(kinds, weights)[0](run, draw)
                lasts_s = draw.choice([0.3, 0.7, 1.5, 2.0, 3.0, 4.0])
                if arguments.only and arguments.only not in fault.name:
                    continue
                run.one(fault, lasts_s)
                count += 1
            print(f'{count} faults in {time.monotonic() - begin:.0f} s, {len(run.supervisor.starts)} starts, seed {arguments.seed}')
            ended = run.failed == 0
        finally:
            run.machine.close()
            if run.supervisor.running:
                run.supervisor.process.kill()
                for thread in run.stopped:
                    thread.release()
                run.supervisor.process.wait()
            if not ended:
                run.log.reading = True
                run.log.look()
                print('\n'.join(run.log.said.decode(errors='replace').splitlines()[-80:]))
            # Twice where a fault put another one in its place.
            while subprocess.run(['umount', '-l', run.state], check=False, stderr=subprocess.DEVNULL).returncode == 0:
                pass
    sys.exit(1 if run.failed else 0)


if __name__ == '__main__':
    main()
