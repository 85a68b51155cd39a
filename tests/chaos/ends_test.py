#!/usr/bin/env python3
"""Each thread of godwitd stands, in its turn, while it is told to end; so does that of `godwit view`. It ends in the time that the
unit gives it, and says whom it leaves behind; for whoever only writes log, flight log or events nobody waits in vain.

    ends_test.py GODWIT GODWITD UNIT [--only THREAD,..]
"""
import argparse
import os
import pathlib
import signal
import socket
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
sys.path.insert(1, os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
import one_thread  # noqa: E402
from machine import Machine  # noqa: E402
from supervisor import Rules  # noqa: E402

AT_ONCE = 4
START_S = 120
# They hold a share of what they work on, and are left to it without a word.
LEFT_ALONE = ('gw-log', 'gw-flightlog', 'gw-eventwrite')
# Who is waited for, and is named.
NAMED = ('gw-camera', 'gw-tracker', 'gw-mapper', 'gw-detector', 'gw-link', 'gw-link-keep', 'gw-events', 'gw-live', 'gw-watchdog',
         'gw-end', 'godwitd')


class Ending:
    """A program of which one thread stands."""

    def __init__(self, thread, command, folder, ready, environment=None):
        self.thread, self.ready, self.stopped, self.t_told, self.took = thread, ready, None, 0.0, None
        self.log_path = folder / 'log'
        with open(self.log_path, 'wb') as log:
            self.process = subprocess.Popen(command, stdout=log, stderr=log, env={**os.environ, **(environment or {})})

    def said(self):
        return self.log_path.read_text(errors='replace')

    def stand(self):
        give_up = time.monotonic() + START_S
        while self.ready not in self.said() or self.thread not in one_thread.threads(self.process.pid):
            if self.process.poll() is not None or time.monotonic() > give_up:
                raise SystemExit(f'FAILED: no "{self.ready}" or no {self.thread}:\n{self.said()}')
            time.sleep(0.02)
        self.stopped = one_thread.StoppedThread(one_thread.threads(self.process.pid)[self.thread])

    def tell(self, how):
        self.process.send_signal(how)
        self.t_told = time.monotonic()

    def look(self):
        self.stopped.look()
        if self.took is None and self.process.poll() is not None:
            self.took = time.monotonic() - self.t_told

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
            if self.stopped is not None:
                self.stopped.release()
            self.process.wait()


def daemon(arguments, thread, folder, recording, number):
    folder.mkdir()
    (folder / 'state').mkdir()
    config = folder / 'godwit.toml'
    config.write_text(f'[camera]\nsource = "replay"\nsequence = "{recording}"\n[can]\nbus = "multicast:9:127.0.0.1"\n'
                      f'node_id = {60 + number}\n[detector]\nenabled = {str(thread == "gw-detector").lower()}\n[link]\nstate_folder = "{folder}/state"\n[live]\nsocket = "{folder}/live"\n')
    notify = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    notify.bind(str(folder / 'notify'))
    out = Ending(thread, [arguments.godwitd, '--config', config], folder, 'detections come' if thread == 'gw-detector' else 'INITIALISING',
                 {'NOTIFY_SOCKET': str(folder / 'notify'), 'WATCHDOG_USEC': '2000000'})
    out.notify = notify  # read by nobody: that holds nobody up either
    return out


def view(arguments, thread, folder, _recording, _number):
    folder.mkdir()
    return Ending(thread, [arguments.godwit, 'view', '--socket', folder / 'none', '--port', '0'], folder, 'http://127.0.0.1:')


def await_ends(endings, rules, machine):
    """Until all have ended, or had the time for it."""
    while late := [e for e in endings if e.took is None]:
        for ending in late:
            ending.look()
        limits = [rules.stop_s * machine.slowness(e.t_told) + machine.stall(e.t_told) for e in late]
        if all(time.monotonic() - e.t_told > limit for e, limit in zip(late, limits)):
            return
        time.sleep(0.01)


def judge(ending, rules, machine, wanted):
    """What is wrong; empty: nothing."""
    limit = rules.stop_s * machine.slowness(ending.t_told) + machine.stall(ending.t_told)
    if ending.took is None or ending.took > limit:
        return f'does not end in {limit:.1f} s ({ending.took})'
    code, said = ending.process.returncode, ending.said()
    print(f'{ending.thread} stands: ended with {code} after {ending.took:.1f} s', flush=True)
    # Of the main thread itself the look at who stands hears the code.
    if ending.thread != 'godwitd' and code != (0 if wanted is None else 1):
        return f'ended with {code}'
    left = [line.split(': ')[1] for line in said.splitlines() if 'does not end: ending without it' in line]
    # Where the log itself stands nobody hears whom it leaves.
    if ending.thread != 'gw-log' and left != ([] if wanted is None else [f'{wanted} does not end']):
        return f'says {left}'
    return ''


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ('godwit', 'godwitd', 'unit'):
        parser.add_argument(name)
    parser.add_argument('--only', default='', help='threads, by their names')
    arguments = parser.parse_args()
    rules = Rules(arguments.unit)
    cases = [(daemon, t, None) for t in LEFT_ALONE]
    cases += [(daemon, t, 'the main thread' if t == 'godwitd' else t) for t in NAMED]
    cases.append((view, 'gw-watch', 'gw-watch'))
    cases = [case for case in cases if not arguments.only or case[1] in arguments.only.split(',')]
    wrong, machine = [], Machine()
    with tempfile.TemporaryDirectory(prefix='godwit_ends.') as name:
        recording = pathlib.Path(name) / 'recording'
        subprocess.run([arguments.godwit, 'sim', 'street', '--frames', '20', '--out', recording], check=True, stdout=subprocess.DEVNULL)
        for begin in range(0, len(cases), AT_ONCE):
            group = cases[begin:begin + AT_ONCE]
            endings = []
            try:
                for i, (make, thread, _) in enumerate(group):
                    endings.append(make(arguments, thread, pathlib.Path(name) / f'{begin + i}', recording, i))
                for ending, (make, _, _) in zip(endings, group):
                    ending.stand()
                    ending.tell(signal.SIGTERM if make is daemon else signal.SIGINT)
                await_ends(endings, rules, machine)
                for ending, (_, _, wanted) in zip(endings, group):
                    if what := judge(ending, rules, machine, wanted):
                        wrong.append(f'{ending.thread} stands: {what}')
                        print(f'FAIL  {wrong[-1]}\n{ending.said()}', flush=True)
            finally:
                for ending in endings:
                    ending.close()
    machine.close()
    if wrong:
        raise SystemExit('FAILED: ' + '; '.join(wrong))
    print('ends: ok')


main()
