"""The figures of the report's tables: which ones, how they are called, and how they are written.

Those that summary.json has are taken from it, never computed again; the others are what scripts/evaluate tells.
"""
import dataclasses


@dataclasses.dataclass
class Row:
    """key: path in summary.json ('ms.median'), or one of judged figures after 'judged.'. kind: how its text is written."""
    key: str
    told: str
    kind: str = 'number'
    instead: 'Row | None' = None  # shown where a run has no value for key


HEAD = [
    Row('judged.false_sure', 'false-sure frames', 'count'),
    Row('judged.metric_ate_m', 'ATE in metres, not scaled', 'length', instead=Row('judged.ate_m', 'ATE, after a similarity', 'length')),
    Row('tracked_share', 'frames tracked', 'share'),
    Row('first_pose_after_frames', 'first pose after', 'frames'),
    Row('ms.median', 'a frame, median', 'ms'),
    Row('ms.p99', 'a frame, p99', 'ms'),
]
GROUPS = [
    ('Tracking', [
        Row('frames', 'pictures due', 'count'), Row('processed', 'pictures flown', 'count'), Row('tracked', 'tracked', 'count'),
        Row('tracked_share', 'share of all pictures', 'share'),
        Row('tracked_share_after_first_pose', 'share from the first pose on', 'share'),
        Row('first_pose_after_frames', 'first pose after', 'frames'), Row('first_pose_after_ms', 'first pose after', 'ms'),
        Row('maps', 'maps', 'count'), Row('poses_hz', 'poses a second', 'number')]),
    ('Error against the truth', [
        Row('judged.false_sure', 'false-sure frames', 'count'), Row('judged.off_5cm_frames', 'frames off by more than 5 cm', 'count'),
        Row('judged.ate_m', 'ATE, longest map, after a similarity', 'length'), Row('judged.ate_max_m', 'largest error in it', 'length'),
        Row('judged.rpe_1s_m', 'RPE over 1 s, translation', 'length'), Row('judged.rpe_1s_deg', 'RPE over 1 s, rotation', 'degrees'),
        Row('judged.flown_m', 'way flown', 'length'),
        Row('judged.metric_ate_m', 'ATE in metres, not scaled', 'length'),
        Row('judged.metric_scale_error', 'lengths too long by', 'share'), Row('judged.metric_gravity_deg', 'vertical off by', 'degrees'),
        Row('judged.metric_metric_after_s', 'metric after', 'seconds')]),
    ('What the covariance says', [
        Row('judged.rotation_nees_per_dof', 'NEES a degree of freedom, rotation', 'number'),
        Row('judged.direction_nees_per_dof', 'the same, direction', 'number'),
        Row('judged.rotation_coverage_95', 'inside the 95 % region, rotation', 'share'),
        Row('judged.direction_coverage_95', 'the same, direction', 'share'),
        Row('judged.metric_nees_position', 'NEES of metric positions', 'number'),
        Row('judged.metric_nees_attitude', 'NEES of metric attitudes', 'number')]),
    ('Time', [
        Row('ms.median', 'tracking a frame, median', 'ms'), Row('ms.p95', 'p95', 'ms'), Row('ms.p99', 'p99', 'ms'),
        Row('ms.max', 'longest', 'ms'), Row('proc_cpu_ms.mean', 'processor, with mapping, mean', 'ms'),
        Row('age_ms.median', 'age of a pose, median', 'ms'), Row('age_ms.p99', 'p99', 'ms'), Row('age_ms.max', 'oldest', 'ms'),
        Row('peak_memory_mb', 'memory at most', 'mb')]),
    ('Slips', [
        Row('scheduler.late', 'poses after the deadline', 'count'), Row('dropped_late', 'pictures dropped, tracker busy', 'count'),
        Row('dropped_no_slot', 'pictures dropped, no slot', 'count'), Row('bad_pictures', 'pictures missing or broken', 'count'),
        Row('repeated_pictures', 'pictures twice', 'count'), Row('scheduler.rungs_down', 'times something was shed', 'count'),
        Row('scheduler.detections_late', 'detections too late', 'count'), Row('imu.gaps', 'gaps of the inertial sensor', 'count'),
        Row('records_lost', 'lines lost in the files', 'count')]),
]


def value_of(key, run, judged):
    """A number, or None where this run has none."""
    where = run.summary
    if key.startswith('judged.'):
        if judged is None:
            return None
        key = key[len('judged.'):]
        if key == 'false_sure':
            return int(judged.false_sure.sum())
        value = judged.figures.get(key)
    else:
        value = where
        for part in key.split('.'):
            value = value.get(part) if isinstance(value, dict) else None
    return value if isinstance(value, (int, float)) and not isinstance(value, bool) else None


def significant(value, digits=3):
    if value == 0:
        return '0'
    text = f'{value:.{digits}g}'
    if 'e' in text:
        return f'{value:.0f}' if abs(value) >= 1 else f'{value:.2e}'
    return text


def text_of(value, kind):
    """As people read it."""
    if value is None:
        return '–'
    if kind == 'count':
        return f'{value:,}'.replace(',', '\u202f')
    if kind == 'frames':
        return f'{value} frame' + ('s' if value != 1 else '')
    if kind == 'share':
        return f'{100 * value:.2f} %'
    if kind == 'length':
        size = abs(value)
        return f'{1000 * value:.1f} mm' if size < 0.01 else f'{100 * value:.2f} cm' if size < 1 else f'{value:.2f} m'
    units = {'ms': ' ms', 'mb': ' MB', 'degrees': '°', 'seconds': ' s', 'number': ''}
    return significant(value) + units[kind]


def flat(value, key=''):
    """All of a summary as (path, value); events are told elsewhere."""
    if isinstance(value, dict):
        for k, v in value.items():
            if not (key == '' and k == 'events'):
                yield from flat(v, f'{key}.{k}' if key else k)
    elif isinstance(value, list):
        for i, v in enumerate(value):
            yield from flat(v, f'{key}.{i}')
    else:
        yield key, value
