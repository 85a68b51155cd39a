"""What goes wrong in a chaos run. Each fault begins and ends; `lies_after`: when its truth is that camera, tracker or link
thread stands or no picture comes, nothing may say "well" for longer than so many seconds; None: it changes nothing that the
node tells. `stays_well`: it is nobody's failure, and the node must go on saying so."""
import os
import signal
import subprocess
import time

import one_thread

LIE_S = 1.0
MAPPER_LIE_S = 3.0  # one message may take the mapper two seconds
# By name, and what may be said while they stand. The others are no failure of the flight, or are watched at other ends.
THREADS = {'gw-camera': LIE_S, 'gw-tracker': LIE_S, 'gw-link': LIE_S, 'gw-mapper': MAPPER_LIE_S, 'gw-detector': None,
           'gw-link-keep': None, 'gw-log': None, 'gw-flightlog': None, 'gw-events': None, 'gw-eventwrite': None,
           'gw-live': None, 'gw-watchdog': None, 'gw-end': None, 'godwitd': None}
# These concern nobody in flight.
BESIDE = ('gw-detector', 'gw-log', 'gw-flightlog', 'gw-events', 'gw-eventwrite', 'gw-live', 'gw-end')


class Fault:
    lies_after, stays_well = None, False

    def __init__(self, run, random):
        self.run, self.pid = run, run.supervisor.process.pid
        self.name = type(self).__name__

    def begin(self):
        pass

    def end(self):
        pass


class ThreadStands(Fault):
    def __init__(self, run, random, name=None):
        super().__init__(run, random)
        self.thread = name or random.choice(sorted(THREADS))
        self.name = f'thread {self.thread} stands'
        self.lies_after = THREADS[self.thread]
        self.stays_well = self.thread in BESIDE
        self.stopped = None

    def begin(self):
        tid = one_thread.threads(self.pid).get(self.thread)
        if tid is None:
            raise SystemExit(f'FAILED: no thread {self.thread} in {sorted(one_thread.threads(self.pid))}')
        self.stopped = one_thread.StoppedThread(tid)
        self.run.stopped.append(self.stopped)

    def end(self):
        self.stopped.release()
        self.run.stopped.remove(self.stopped)


class ProcessStands(Fault):
    lies_after = LIE_S

    def begin(self):
        os.kill(self.pid, signal.SIGSTOP)

    def end(self):
        if self.run.supervisor.running and self.run.supervisor.process.pid == self.pid:
            os.kill(self.pid, signal.SIGCONT)


class PicturesAreGone(Fault):
    lies_after = LIE_S

    def begin(self):
        self.run.pictures.rename(self.run.recording / 'away')

    def end(self):
        (self.run.recording / 'away').rename(self.run.pictures)


class LogIsNotRead(Fault):
    stays_well = True

    def begin(self):
        self.run.log.reading = False

    def end(self):
        self.run.log.reading = True


class LogReaderGoesAway(Fault):
    stays_well = True

    def begin(self):
        self.run.log.close()

    def end(self):
        self.run.log.open()


class DiscIsFull(Fault):
    stays_well = True

    def begin(self):
        with open(self.run.state / 'filler', 'wb', buffering=0) as filler:
            try:
                while True:
                    filler.write(b'x' * 4096)
            except OSError:
                pass
        self.run.save_parameters()

    def end(self):
        (self.run.state / 'filler').unlink()


class DiscIsReadOnly(Fault):
    """Another, read-only, in its place; at times it must start like that."""
    stays_well = True

    def __init__(self, run, random):
        super().__init__(run, random)
        self.at_start = random.random() < 0.5
        self.stays_well = not self.at_start
        self.name += ' at a start' if self.at_start else ''

    def begin(self):
        subprocess.run(['mount', '-t', 'tmpfs', '-o', 'ro,size=4k', 'none', self.run.state], check=True)
        if self.at_start:
            self.run.supervisor.kill('the test', signal.SIGKILL)
        self.run.save_parameters()

    def end(self):
        subprocess.run(['umount', '-l', self.run.state], check=True)


class BusIsDown(Fault):
    def begin(self):
        self.run.bus_is_up = False
        subprocess.run(['ip', 'link', 'set', 'lo', 'down'], check=True)

    def end(self):
        subprocess.run(['ip', 'link', 'set', 'lo', 'up'], check=True)
        subprocess.run(['ip', 'link', 'set', 'lo', 'multicast', 'on'], check=True)
        subprocess.run(['ip', 'route', 'add', '239.0.0.0/8', 'dev', 'lo'], check=True)
        self.run.bus_is_up, self.run.t_bus_up = True, time.monotonic()


class BusIsFlooded(Fault):
    """Frames of nobody, some of them broken, as a bad node sends."""

    def __init__(self, run, random):
        super().__init__(run, random)
        self.random = random

    def begin(self):
        self.run.flood = self.random

    def end(self):
        self.run.flood = None


class HangUp(Fault):
    stays_well = True

    def begin(self):
        os.kill(self.pid, signal.SIGHUP)


class Killed(Fault):
    def begin(self):
        self.run.supervisor.kill('the test', signal.SIGKILL)


class ToldToEnd(Fault):
    """SIGTERM; in two of three cases while a thread stands that never ends by itself."""

    def __init__(self, run, random):
        super().__init__(run, random)
        hanging = random.choice([None, *sorted(THREADS)])
        self.stands = ThreadStands(run, random, hanging) if hanging else None
        self.name = 'told to end' + (f' while {hanging} stands' if hanging else '')

    def begin(self):
        if self.stands is not None:
            self.stands.begin()
        self.run.supervisor.stop()
        begin, rules = time.monotonic(), self.run.supervisor.rules
        while self.run.supervisor.running and self.run.supervisor.process.pid == self.pid:
            self.run.turn()
            if time.monotonic() - begin > 60:
                raise SystemExit('FAILED: neither SIGTERM nor SIGKILL end it')
        took = time.monotonic() - begin
        self.run.check(not any(k[1] == self.pid for k in self.run.supervisor.kills),
                       f'it ended within {rules.stop_s:.0f} s of SIGTERM ({took:.1f} s)')

    def end(self):
        if self.stands is not None:
            self.stands.end()


# How often each comes, of all.
ALL = [(ThreadStands, 9), (ProcessStands, 1), (PicturesAreGone, 2), (LogIsNotRead, 1), (LogReaderGoesAway, 1), (DiscIsFull, 1),
       (DiscIsReadOnly, 1), (BusIsDown, 1), (BusIsFlooded, 1), (HangUp, 1), (Killed, 1), (ToldToEnd, 2)]
