"""What godwitd keeps resident in flight: a replayed 640 x 480 camera, the detector, all memory locked. Once alone; once with the
flight log, the event recorder with an event now and then, and a reader of `godwit top`: then it must stay as it is.

  memory_test.py GODWIT GODWITD [SECONDS]      SECONDS of the second flight between first and last look; 20 if not said
"""
import os
import pathlib
import re
import signal
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent.parent))
from flying_daemon import Daemon, fail  # noqa: E402

GODWIT, GODWITD = sys.argv[1:3]
SECONDS = float(sys.argv[3]) if len(sys.argv) > 3 else 20
MOST_MB = 250
RECORDER_MB = 60  # the event recorder's own budget
GROWTH_MB = 1  # what the C library's heap may still shift about


def memory_mb(daemon):
    status = pathlib.Path(f'/proc/{daemon.process.pid}/status').read_text()
    return {key: int(kb) * 1024 / 1e6 for key, kb in re.findall(r'^(Vm\w+):\s+(\d+) kB', status, re.M)}


def started(folder, more):
    config = folder / 'godwit.toml'
    config.write_text(f'[threads]\nlock_memory = true\n[camera]\nsource = "replay"\nsequence = "{folder}/recording"\n'
                      f'[can]\nbus = "multicast:9:127.0.0.1"\nnode_id = 45\n{more}')
    daemon = Daemon(GODWITD, config)
    daemon.says('detections come')
    time.sleep(5)  # the map and its workspaces have been used
    if any('is not locked' in line for line in daemon.said):
        print('SKIPPED: memory may not be locked here')
        sys.exit(1 if os.environ.get('CI') == 'true' else 77)
    return daemon


def told(what, memory):
    print(f'{what}: resident {memory["VmRSS"]:.2f} MB, locked {memory["VmLck"]:.0f} MB, highest {memory["VmHWM"]:.0f} MB', flush=True)


def alone(folder):
    daemon = started(folder, '')
    memory = memory_mb(daemon)
    daemon.end()
    told('alone', memory)
    if memory['VmRSS'] > MOST_MB:
        fail(f'more than {MOST_MB} MB')


def event(daemon, count):
    """Asks for the next event, and waits until it is written."""
    daemon.process.send_signal(signal.SIGUSR1)
    while sum('event: request' in line for line in daemon.said) < count:
        if daemon.process.poll() is not None:
            fail(''.join(daemon.said))
        time.sleep(0.2)


def recorded_and_looked_at(folder):
    daemon = started(folder, f'[flight_log]\nfolder = "{folder}/flights"\n[live]\nsocket = "{folder}/live"\n'
                             f'[recorder]\nfolder = "{folder}/events"\nmemory_mb = {RECORDER_MB}\nbefore_s = 1\nafter_s = 1\n')
    with open(folder / 'top', 'w', encoding='utf-8') as seen:
        reader = subprocess.Popen([GODWIT, 'top', '--json', '--socket', folder / 'live'], stdout=seen)
        event(daemon, 1)
        time.sleep(2)
        before = memory_mb(daemon)
        told('with log, event recorder and a reader, after its first event', before)
        end = time.monotonic() + SECONDS
        event(daemon, 2)
        time.sleep(max(0, end - time.monotonic()))
        after = memory_mb(daemon)
        told(f'{SECONDS:.0f} s and an event later', after)
        reader.terminate()
        reader.wait()
    daemon.end()
    if not list((folder / 'flights').glob('*.ulg')) or len(list((folder / 'events').glob('*-request'))) != 2:
        fail('log or events are missing')
    if len((folder / 'top').read_text().splitlines()) < SECONDS / 10:
        fail('nobody looked')
    if after['VmRSS'] - RECORDER_MB > MOST_MB:
        fail(f'more than {MOST_MB} MB beside the event recorder')
    if after['VmRSS'] - before['VmRSS'] > GROWTH_MB:
        fail('it grows')


def main():
    with tempfile.TemporaryDirectory(prefix='godwit_memory.') as name:
        folder = pathlib.Path(name)
        subprocess.run([GODWIT, 'sim', 'street', '--frames', '40', '--out', folder / 'recording'], check=True,
                       stdout=subprocess.DEVNULL)
        alone(folder)
        recorded_and_looked_at(folder)


main()
