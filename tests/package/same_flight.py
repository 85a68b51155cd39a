#!/usr/bin/python3
"""Flies the same pictures with the programs of both packages' builds and compares how far they are off.

  same_flight.py [--frames N] [--starts N] [--detector] BUILD_AMD64 BUILD_ARM64 [SCENARIO | RECORDING ..]

arm64 runs under qemu. A scenario's pictures are drawn once, without loss, by amd64's program: to draw one takes some ten
times as long as to fly it, and what arm64 draws is the matter of tests/sim. Both fly in one thread (--sequential), so that
nothing depends on speed.

One flight of each says little: arm64 rounds sums in another order, its first map may begin a picture earlier, and begun at one or
another of the night's first fourteen pictures amd64 itself is off by 6.1 to 11.1 mm. So both fly from several pictures on (--starts,
each one later), and what is compared are the ATEs of all these flights. Fails where arm64's median ATE is more than a
tenth above amd64's and that is no chance (below), or where it tracks fewer than 0.98 of the frames that amd64 tracks. Without
SCENARIO: street, night, corridor, and of the recordings tum_fr1_xyz, which lie in GODWIT_SHARED_DIR/data (../shared/data).
"""
import argparse
import concurrent.futures
import itertools
import json
import os
import pathlib
import re
import statistics
import subprocess
import sys
import tempfile

SOURCE = pathlib.Path(__file__).resolve().parents[2]
RECORDINGS = pathlib.Path(os.environ.get('GODWIT_SHARED_DIR', SOURCE.parent / 'shared')) / 'data'
ALL = ['street', 'night', 'corridor', 'tum_fr1_xyz']
# Four comparisons: by chance alone one run in fifty would fail at most. Of seven starts each, 1 / 3432 is the least there is.
NO_CHANCE = 0.005


def emulator(build):
    """As the toolchain wrote it down; empty for this machine's own programs."""
    found = re.search(r'^GODWIT_EMULATOR:\w+=(.*)$', (build / 'CMakeCache.txt').read_text(encoding='utf-8'), re.M)
    return found.group(1).split(';') if found else []


def call(build, *words):
    done = subprocess.run([*emulator(build), build / 'firmware_app/godwit', *words], capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f'{build}: godwit {" ".join(map(str, words))}: ended with {done.returncode}:\n{done.stdout}{done.stderr}')


def fly(build, pictures, start, a, out):
    call(build, 'replay', pictures, '--sequential', '--start', str(start), '--frames', str(a.frames),
         '--detector', 'on' if a.detector else 'off', '--out', out)
    said = subprocess.run(['/usr/bin/python3', SOURCE / 'scripts/evaluate', pictures / 'groundtruth.txt', out, '--json'],
                          check=True, capture_output=True, text=True).stdout
    return json.loads(said)


def chance(amd64, arm64):
    """How likely arm64's ranks among all would be as high as they are, or higher, did the processor make no difference:
    Wilcoxon's rank-sum test, one-sided and exact. Both are lists of what is better the lower it is."""
    together = amd64 + arm64
    rank = [sum(other < own for other in together) + 0.5 * sum(other == own for other in together) for own in together]
    seen = sum(rank[len(amd64):])
    sums = [sum(some) for some in itertools.combinations(rank, len(arm64))]
    return sum(one >= seen for one in sums) / len(sums)


def worse(amd64, arm64):
    """Whether arm64's flights are further off than amd64's, by their ATEs [m]."""
    return statistics.median(arm64) > 1.1 * statistics.median(amd64) and chance(amd64, arm64) < NO_CHANCE


def compare(name, a):
    """The line to be told of a scenario or recording, and whether it is as it should be."""
    if name == 'tum_fr1_xyz' and not (RECORDINGS / name).is_dir():
        return f'{name}: {RECORDINGS} does not have it: SKIPPED', os.environ.get('CI') != 'true'
    with tempfile.TemporaryDirectory(prefix='godwit_same.') as folder:
        pictures = RECORDINGS / name
        if not pictures.is_dir():
            pictures = pathlib.Path(folder) / 'pictures'
            call(a.builds[0], 'sim', name, '--frames', str(a.frames + a.starts - 1), '--format', 'png', '--out', pictures)
        both = [[fly(build, pictures, start, a, pathlib.Path(folder) / 'flight') for start in range(a.starts)]
                for build in a.builds]
    if not all('ate_m' in flight for flights in both for flight in flights):
        return f'{name}, {a.frames} frames: too few poses to compare  FAILED', False
    amd64, arm64 = ([flight['ate_m'] for flight in flights] for flights in both)
    tracked = [statistics.mean(flight['tracked_share'] for flight in flights) for flights in both]
    good = not worse(amd64, arm64) and tracked[1] >= 0.98 * tracked[0]
    told = [f'{statistics.median(ates):.5f} ({min(ates):.5f} to {max(ates):.5f})' for ates in (amd64, arm64)]
    return (f'{name}, {a.frames} frames from {a.starts} starts: ATE {told[0]} m on amd64, {told[1]} m on arm64, by chance as high '
            f'{chance(amd64, arm64):.4f}; tracked {tracked[0]:.3f}, {tracked[1]:.3f}' + ('' if good else '  FAILED')), good


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--frames', type=int, default=300)
    parser.add_argument('--starts', type=int, default=7)
    parser.add_argument('--detector', action='store_true')
    parser.add_argument('builds', nargs=2, type=pathlib.Path)
    parser.add_argument('names', nargs='*')
    a = parser.parse_args()
    if not 5 <= a.starts <= 9:
        parser.error('--starts: of fewer than five the ranks cannot tell chance apart, of more than nine they take minutes')
    failed = 0
    # One thread a flight, and none hangs on time: a flight a processor.
    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        for told, good in pool.map(lambda name: compare(name, a), a.names or ALL):
            failed |= not good
            print(told, flush=True)
    return int(failed)


if __name__ == '__main__':
    sys.exit(main())
