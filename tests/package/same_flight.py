#!/usr/bin/python3
"""Flies the same scenarios and recordings with the programs of both packages' builds and compares how far they are off.

  same_flight.py [--frames N] [--detector] BUILD_AMD64 BUILD_ARM64 [SCENARIO | RECORDING ..]

arm64 runs under qemu (some two seconds a simulated frame). Both fly in one thread (--sequential), so that nothing depends on
speed. Fails where arm64's ATE is more than a tenth above amd64's, or where it tracks fewer than 0.98 of its frames. Without
SCENARIO: street, night, corridor, and of the recordings tum_fr1_xyz, which lie in GODWIT_SHARED_DIR/data (../shared/data).
"""
import argparse
import concurrent.futures
import json
import os
import pathlib
import re
import subprocess
import sys
import tempfile

SOURCE = pathlib.Path(__file__).resolve().parents[2]
RECORDINGS = pathlib.Path(os.environ.get('GODWIT_SHARED_DIR', SOURCE.parent / 'shared')) / 'data'
ALL = ['street', 'night', 'corridor', 'tum_fr1_xyz']


def emulator(build):
    """As the toolchain wrote it down; empty for this machine's own programs."""
    found = re.search(r'^GODWIT_EMULATOR:\w+=(.*)$', (build / 'CMakeCache.txt').read_text(encoding='utf-8'), re.M)
    return found.group(1).split(';') if found else []


def fly(build, name, a, out):
    what = ['replay', RECORDINGS / name] if (RECORDINGS / name).is_dir() else ['fly', name]
    done = subprocess.run([*emulator(build), build / 'firmware_app/godwit', *what, '--sequential', '--frames', str(a.frames),
                           '--detector', 'on' if a.detector else 'off', '--out', out], capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f'{build}: {name}: ended with {done.returncode}:\n{done.stdout}{done.stderr}')
    truth = (RECORDINGS / name if what[0] == 'replay' else out) / 'groundtruth.txt'
    said = subprocess.run(['/usr/bin/python3', SOURCE / 'scripts/evaluate', truth, out, '--json'], check=True,
                          capture_output=True, text=True).stdout
    return json.loads(said)


def compare(name, a):
    """The line to be told of a scenario or recording, and whether it is as it should be."""
    if name == 'tum_fr1_xyz' and not (RECORDINGS / name).is_dir():
        return f'{name}: {RECORDINGS} does not have it: SKIPPED', os.environ.get('CI') != 'true'
    with tempfile.TemporaryDirectory(prefix='godwit_same.') as folder:
        amd64, arm64 = (fly(build, name, a, pathlib.Path(folder) / str(number)) for number, build in enumerate(a.builds))
    if 'ate_m' not in amd64 or 'ate_m' not in arm64:
        return f'{name}, {a.frames} frames: too few poses to compare  FAILED', False
    good = arm64['ate_m'] <= 1.1 * amd64['ate_m'] and arm64['tracked_share'] >= 0.98 * amd64['tracked_share']
    return (f'{name}, {a.frames} frames: ATE {amd64["ate_m"]:.5f} m on amd64, {arm64["ate_m"]:.5f} m on arm64; '
            f'tracked {amd64["tracked_share"]:.3f}, {arm64["tracked_share"]:.3f}' + ('' if good else '  FAILED')), good


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--frames', type=int, default=300)
    parser.add_argument('--detector', action='store_true')
    parser.add_argument('builds', nargs=2, type=pathlib.Path)
    parser.add_argument('names', nargs='*')
    a = parser.parse_args()
    failed = 0
    # One thread a flight, and none hangs on time: a flight a processor.
    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        for told, good in pool.map(lambda name: compare(name, a), a.names or ALL):
            failed |= not good
            print(told, flush=True)
    return int(failed)


if __name__ == '__main__':
    sys.exit(main())
