"""What a run of godwit left in its folder, read and looked over (docs/formats.md).

read() refuses what is no whole run with a RunError, whose text says what is there instead. A summary.json whose counts are
not those of frames.csv is refused as well: a report must not show figures of two runs as one.
"""
import csv
import dataclasses
import json
import math
import pathlib
import re

import numpy as np

FILES = ('summary.json', 'frames.csv', 'pose.csv', 'trajectory.tum')
# Without these keys it is not the summary of a run; docs/figures.schema.json has them all.
SUMMARY_KEYS = ('version', 'sequence', 'mode', 'pace', 'frames', 'processed', 'tracked', 'tracked_share', 'maps', 'ms')
FRAME_COLUMNS = ('t', 'ms', 'tracked', 'map_id', 'state', 'features', 'fate', 'reason')
STATES = ('INITIALISING', 'TRACKING', 'COASTING', 'RELOCALISING', 'LOST')


class RunError(Exception):
    """A folder that holds no whole run; the text is for people."""


@dataclasses.dataclass
class Run:
    """One run. Times in seconds of the sequence; poses n x 9: t, place, quaternion x y z w (camera to world), map."""
    folder: pathlib.Path
    name: str
    summary: dict
    frames: list            # rows of frames.csv, all text
    t: np.ndarray           # of each frame
    tracked: np.ndarray     # of each frame
    poses: np.ndarray
    metric: bool            # poses are metres in one frame (--imu on), as pose.csv tells

    def column(self, name):
        """A column of frames.csv; NaN where it is empty."""
        return np.array([float(f[name]) if f.get(name) else np.nan for f in self.frames])

    def least_features(self):
        """Without how many features a frame of this run does not count as tracked, as its reasons tell; None: none does."""
        told = (re.fullmatch(r'tracking(?:,[^:]*)?: \d+ of (\d+)', f['reason']) for f in self.frames)
        return next((int(match.group(1)) for match in told if match), None)


def entries(folder):
    names = sorted(p.name for p in folder.iterdir())
    return ', '.join(names[:4]) + (' ..' if len(names) > 4 else '')


def look_over(folder):
    """RunError unless all four files are there under their names."""
    if not folder.exists():
        raise RunError(f'{folder}: there is no such folder')
    if not folder.is_dir():
        raise RunError(f'{folder}: not a folder; a run is the folder that --out named')
    try:
        if not any(folder.iterdir()):
            raise RunError(f'{folder}: empty, no run was written there')
        missing = [name for name in FILES if not (folder / name).is_file()]
        if not missing:
            return
        begun = [name for name in FILES if (folder / (name + '.part')).exists()]
        if begun:
            raise RunError(f'{folder}: half written: {begun[0]}.part is there, but not {missing[0]}. '
                           'The run is still going on, or it was killed')
        if len(missing) < len(FILES):
            raise RunError(f'{folder}: not whole: {", ".join(missing)} missing')
        raise RunError(f'{folder}: holds no run of godwit (neither {", ".join(FILES[:-1])} nor {FILES[-1]}), but {entries(folder)}')
    except OSError as e:
        raise RunError(f'{folder}: cannot be read: {e.strerror}') from e


def read_summary(file):
    try:
        summary = json.loads(file.read_text(encoding='utf-8'))
    except ValueError as e:
        raise RunError(f'{file}: not JSON: {e}') from e
    missing = [k for k in SUMMARY_KEYS if not isinstance(summary, dict) or k not in summary]
    if missing:
        raise RunError(f'{file}: not the summary of a run: it has no "{missing[0]}"')
    for key in ('frames', 'processed', 'tracked', 'maps'):
        if not isinstance(summary[key], int) or summary[key] < 0:
            raise RunError(f'{file}: "{key}" is no count: {summary[key]!r}')
    for key in ('ms', 'thread_cpu_ms', 'proc_cpu_ms', 'age_ms'):
        of = summary.get(key, {})
        if not isinstance(of, dict) or not all(is_number(v) for v in of.values()):
            raise RunError(f'{file}: "{key}" holds no figures: {str(of)[:60]}')
    events = summary.get('events', [])
    if not isinstance(events, list) or not all(is_event(e) for e in events):
        raise RunError(f'{file}: "events" is no list of events')
    return summary


def is_number(value):
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def is_event(value):
    """{t, what, before, which, why, value, limit}: numbers are numbers."""
    return isinstance(value, dict) and is_number(value.get('t')) and all(is_number(value.get(k, 0)) for k in ('value', 'limit'))


def read_frames(file):
    with open(file, newline='', encoding='utf-8') as f:
        rows = list(csv.DictReader(f))
        f.seek(0)
        header = next(csv.reader(f), [])
    missing = [c for c in FRAME_COLUMNS if c not in header]
    if missing:
        raise RunError(f'{file}: not the frames of a run: it has no column "{missing[0]}"')
    for number, row in enumerate(rows, 2):
        if any(row[c] is None for c in FRAME_COLUMNS):
            raise RunError(f'{file}:{number}: the line is cut off')
        if row['tracked'] not in ('0', '1'):
            raise RunError(f'{file}:{number}: tracked is 0 or 1, not "{row["tracked"]}"')
        try:
            # Empty: not known for this frame.
            values = [float(v) for k, v in row.items() if v and (k in ('t', 'ms', 'features') or k.endswith('_ms'))]
        except (ValueError, TypeError, AttributeError) as e:
            raise RunError(f'{file}:{number}: {e}') from e
        if not row['t'] or not all(map(math.isfinite, values)):
            raise RunError(f'{file}:{number}: no finite number')
    return rows


def read_poses(file):
    rows = []
    for number, line in enumerate(file.read_text(encoding='utf-8').splitlines(), 1):
        if not line.strip() or line.startswith('#'):
            continue
        try:
            row = [float(x) for x in line.split()]
        except ValueError as e:
            raise RunError(f'{file}:{number}: {e}') from e
        if len(row) != 9:
            raise RunError(f'{file}:{number}: {len(row)} numbers, not 9 (t tx ty tz qx qy qz qw map_id)')
        if not all(map(math.isfinite, row)) or not any(row[4:8]):
            raise RunError(f'{file}:{number}: no pose: not finite, or a quaternion of zeros')
        rows.append(row)
    return np.array(rows) if rows else np.zeros((0, 9))


def is_metric(file):
    """Looks pose.csv over; whether it holds poses with a told scale."""
    metric = False
    with open(file, newline='', encoding='utf-8') as f:
        rows = csv.reader(f)
        header = next(rows, [])
        if 't' not in header:
            raise RunError(f'{file}: not the poses of a run: it has no column "t"')
        scale = header.index('scale_sigma') if 'scale_sigma' in header else None
        for number, row in enumerate(rows, 2):
            if len(row) != len(header):
                raise RunError(f'{file}:{number}: {len(row)} fields, not {len(header)}: the line is cut off')
            try:
                finite = all(math.isfinite(float(v)) for name, v in zip(header, row) if v and name != 'state')
            except ValueError as e:
                raise RunError(f'{file}:{number}: {e}') from e
            if not finite:
                raise RunError(f'{file}:{number}: not finite')
            metric = metric or scale is not None and row[scale] != ''
    return metric


def read(folder, name=None):
    """The run in `folder`. RunError: it is no whole run, and why."""
    folder = pathlib.Path(folder)
    look_over(folder)
    try:
        summary = read_summary(folder / 'summary.json')
        frames = read_frames(folder / 'frames.csv')
        poses = read_poses(folder / 'trajectory.tum')
        metric = is_metric(folder / 'pose.csv')
    except (OSError, UnicodeDecodeError, csv.Error) as e:
        raise RunError(f'{folder}: cannot be read: {e}') from e
    tracked = np.array([f['tracked'] == '1' for f in frames], dtype=bool)
    counts = {'frames': len(frames), 'tracked': int(tracked.sum()),
              'processed': sum(f['fate'] == 'processed' for f in frames)}
    for key, count in counts.items():
        if summary[key] != count:
            raise RunError(f'{folder}: the files are not of one run: summary.json tells {summary[key]} {key}, '
                           f'frames.csv {count}')
    if len(poses) != counts['tracked']:
        raise RunError(f'{folder}: the files are not of one run: {counts["tracked"]} frames were tracked, '
                       f'trajectory.tum has {len(poses)} poses')
    t = np.array([float(f['t']) for f in frames])
    return Run(folder, name or folder.resolve().name, summary, frames, t, tracked, poses, metric)
