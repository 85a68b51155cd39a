"""Stops one thread of a child process and lets it go again, by ptrace: the others run on, as when a driver hangs."""
import ctypes
import os
import pathlib
import time

SEIZE, INTERRUPT, DETACH = 0x4206, 0x4207, 17
WALL = 0x40000000  # of waitpid: threads too
_libc = ctypes.CDLL(None, use_errno=True)
_libc.ptrace.argtypes = [ctypes.c_long, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p]
_libc.ptrace.restype = ctypes.c_long


def threads(pid):
    """Thread ids by name; those of equal names: one of them."""
    out = {}
    for task in pathlib.Path(f'/proc/{pid}/task').glob('*'):
        try:
            out[(task / 'comm').read_text().strip()] = int(task.name)
        except OSError:  # it has just ended
            pass
    return out


def is_first(tid):
    """Whether it is its process's first thread, whose id is the process's; not, if it has just ended."""
    try:
        status = pathlib.Path(f'/proc/{tid}/status').read_text()
    except OSError:
        return False
    return f'\nTgid:\t{tid}\n' in status


class StoppedThread:
    """Stopped from here on. One thread of the tester makes and releases it: ptrace belongs to a thread."""

    def __init__(self, tid):
        self.tid = tid
        self.first = is_first(tid)
        self.held = _libc.ptrace(SEIZE, tid, None, None) == 0 and _libc.ptrace(INTERRUPT, tid, None, None) == 0
        error = ctypes.get_errno()
        if not self.held and error != 3:  # ESRCH: it has just ended
            raise OSError(error, os.strerror(error), 'ptrace')
        give_up = time.monotonic() + 5
        while self.held and not self.reports():
            if time.monotonic() > give_up:
                raise TimeoutError(f'thread {tid} does not stop')
            time.sleep(0.001)
        if self.held:
            os.waitpid(tid, WALL | os.WNOHANG)

    def look(self):
        """Often, while it is held: of a process that has ended its parent hears nothing before this thread is taken away."""
        try:
            if self.held and self.reports():
                os.waitpid(self.tid, WALL | os.WNOHANG)
                self.held = pathlib.Path(f'/proc/{self.tid}').exists()
        except ChildProcessError:
            self.held = False

    def reports(self):
        """Of a first thread, that it ended is that the process did: how, is left for whoever started that to hear."""
        report = os.waitid(os.P_PID, self.tid, os.WEXITED | os.WSTOPPED | os.WNOHANG | os.WNOWAIT)
        if report is not None and self.first and report.si_code in (os.CLD_EXITED, os.CLD_KILLED, os.CLD_DUMPED):
            self.held = False
            return False
        return report is not None

    def release(self):
        """Goes on, if its process still lives."""
        self.look()
        if self.held and _libc.ptrace(DETACH, self.tid, None, None) == 0:
            self.held = False
        give_up = time.monotonic() + 5
        while self.held and time.monotonic() < give_up:
            self.look()
            time.sleep(0.001)
