"""What godwitd keeps resident in flight: a replayed 640 x 480 camera, the detector, all memory locked.

  memory_test.py GODWIT GODWITD
"""
import os
import pathlib
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time

GODWIT, GODWITD = sys.argv[1:3]
MOST_MB = 250


def memory_mb(process):
    status = pathlib.Path(f'/proc/{process}/status').read_text()
    return {key: int(kb) * 1024 / 1e6 for key, kb in re.findall(r'^(Vm\w+):\s+(\d+) kB', status, re.M)}


def main():
    with tempfile.TemporaryDirectory(prefix='godwit_memory.') as folder_name:
        folder = pathlib.Path(folder_name)
        subprocess.run([GODWIT, 'sim', 'street', '--frames', '40', '--out', folder / 'recording'], check=True,
                       stdout=subprocess.DEVNULL)
        config = folder / 'godwit.toml'
        config.write_text(f'[threads]\nlock_memory = true\n[camera]\nsource = "replay"\nsequence = "{folder}/recording"\n'
                          '[can]\nbus = "multicast:9:127.0.0.1"\nnode_id = 45\n')
        daemon = subprocess.Popen([GODWITD, '--config', config], stderr=subprocess.PIPE, text=True)
        said, there = [], threading.Event()

        def read():
            for line in daemon.stderr:
                said.append(line)
                if 'detections come' in line or 'is not locked' in line:
                    there.set()
        reader = threading.Thread(target=read, daemon=True)
        reader.start()
        try:
            if not there.wait(90):
                sys.exit('FAILED: no detection: ' + ''.join(said))
            time.sleep(5)  # the map and its workspaces have been used
            memory = memory_mb(daemon.pid)
            daemon.send_signal(signal.SIGTERM)
            if daemon.wait(20) != 0:
                sys.exit('FAILED: ' + ''.join(said))
        finally:
            daemon.kill()
            daemon.wait()
        if any('is not locked' in line for line in said):
            print('SKIPPED: memory may not be locked here')
            sys.exit(1 if os.environ.get('CI') == 'true' else 77)
        print(f'resident {memory["VmRSS"]:.0f} MB, locked {memory["VmLck"]:.0f} MB, highest {memory["VmHWM"]:.0f} MB')
        if memory['VmRSS'] > MOST_MB:
            sys.exit(f'FAILED: more than {MOST_MB} MB')


main()
