"""A run against its truth: what scripts/evaluate tells in figures, frame by frame for pictures.

A run of one camera alone is aligned map by map with a similarity, because one camera does not know its scale. A run of
metric poses (--imu on) is one flight in one frame: it is moved and turned as a whole, and never scaled.
"""
import dataclasses
import importlib.machinery
import importlib.util
import pathlib
import sys

import numpy as np

SCRIPTS = pathlib.Path(__file__).resolve().parents[1]
sys.path.insert(0, str(SCRIPTS))
import pose_consistency  # noqa: E402
import pose_metric  # noqa: E402

loader = importlib.machinery.SourceFileLoader('evaluate', str(SCRIPTS / 'evaluate'))
evaluate = importlib.util.module_from_spec(importlib.util.spec_from_loader('evaluate', loader))
loader.exec_module(evaluate)

WINDOW_S = 2.0           # the local scale is that of so long a piece of the way
LEAST_WAY = 0.25         # of what is usual, below which a piece has no scale: it hovers
MOST_WAY = 5000          # points of the way that are drawn
TRUTHS = ('groundtruth.txt', 'mav0/state_groundtruth_estimate0/data.csv', 'state_groundtruth_estimate0/data.csv',
          '../state_groundtruth_estimate0/data.csv')
SENSORS = ('mav0/cam0/sensor.yaml', 'cam0/sensor.yaml', 'sensor.yaml')


@dataclasses.dataclass
class Judged:
    """One value for each pose of the run, in its order; NaN where there is none. Lengths in metres."""
    truth_file: pathlib.Path
    limit_m: float          # of a pose that is false and sure
    t: np.ndarray
    place: np.ndarray       # aligned, n x 3
    truth: np.ndarray       # where the camera was, n x 3; NaN where no truth is near
    way: np.ndarray         # the whole way of the camera from the first picture to the last, m x 4: t, place
    error: np.ndarray
    false_sure: np.ndarray  # bool
    rpe_m: np.ndarray       # over one second from there
    rpe_deg: np.ndarray
    local_scale: np.ndarray  # of the piece of WINDOW_S around it, against what the whole map (or a metre) says
    scale_sigma: np.ndarray  # as told, a share; NaN without an inertial sensor
    consistency: object     # pose_consistency.Judged, or None
    figures: dict           # of scripts/evaluate


def first_file(folders, names):
    for folder in folders:
        for name in names:
            if (folder / name).is_file():
                return folder / name
    return None


def find_truth(run):
    """Truth and sensor.yaml for a run: beside it, as godwit fly writes it, or in the sequence that it names. None: no truth."""
    if (run.folder / 'groundtruth.txt').is_file():
        return run.folder / 'groundtruth.txt', None
    named = pathlib.Path(str(run.summary['sequence']))
    # Relative to where the run was started, which is most often the repository's root.
    folders = [named] if named.is_absolute() else [pathlib.Path.cwd() / named, SCRIPTS.parent / named]
    folders = [f for f in folders if f.is_dir()]
    return first_file(folders, TRUTHS), first_file(folders, SENSORS)


def align_run(run, t_truth, p_truth):
    """Places along the truth's axes, and their errors, as evaluate.position_errors()."""
    if not run.metric:
        return evaluate.position_errors(run.poses, t_truth, p_truth)
    p, good = evaluate.truth_at(t_truth, p_truth, run.poses[:, 0])
    if good.sum() < evaluate.LEAST_POSES:
        return np.full((len(p), 3), np.nan), np.full(len(p), np.nan)
    _, R, shift = pose_metric.align(run.poses[good, 1:4], p[good], False)
    aligned = run.poses[:, 1:4] @ R.T + shift
    return aligned, np.where(good, np.linalg.norm(aligned - p, axis=1), np.nan)


def pieces(run):
    """The poses that can be compared with each other: those of one map, or all of a metric run."""
    if run.metric:
        return [np.arange(len(run.poses))]
    return [np.flatnonzero(run.poses[:, 8] == m) for m in np.unique(run.poses[:, 8])]


def rpe(run, place, truth, R_truth):
    """RPE of each pose: metres and degrees."""
    metres, degrees = np.full(len(run.poses), np.nan), np.full(len(run.poses), np.nan)
    R_own = pose_consistency.rotation(run.poses[:, 4:8])
    for own in pieces(run):
        good = own[np.isfinite(truth[own, 0]) & np.isfinite(place[own, 0])]
        if len(good) < evaluate.LEAST_POSES or np.ptp(place[good], axis=0).max() < 1e-9:
            continue
        _, turn, _ = evaluate.align_similarity(run.poses[good, 1:4], place[good])
        i, m, d = evaluate.relative_errors(run.poses[good, 0], place[good], turn @ R_own[good], truth[good], R_truth[good])
        metres[good[i]], degrees[good[i]] = m, d
    return metres, degrees


def local_scale(run, place, truth):
    """How long a piece of the way came out, over how long it was."""
    out = np.full(len(run.poses), np.nan)
    for own in pieces(run):
        good = own[np.isfinite(truth[own, 0]) & np.isfinite(place[own, 0])]
        if len(good) < evaluate.LEAST_POSES:
            continue
        t = run.poses[good, 0]
        begin, end = np.searchsorted(t, t - WINDOW_S / 2), np.searchsorted(t, t + WINDOW_S / 2, side='right')
        whole = t[end - 1] - t[begin] >= 0.75 * WINDOW_S

        def reach(x):
            """Root mean square distance from the middle of each piece."""
            return np.array([np.sqrt(((x[b:e] - x[b:e].mean(0)) ** 2).sum(1).mean()) for b, e in zip(begin, end)])
        way, came_out = reach(truth[good]), reach(place[good])
        moved = whole & (way > max(LEAST_WAY * np.median(way), 1e-6))
        out[good[moved]] = came_out[moved] / way[moved]
    return out


def told_scale_sigma(run):
    rows = {r['t']: r['scale_sigma'] for r in pose_metric.read_poses(run.folder)} if run.metric else {}
    told = {float(t): float(s) for t, s in rows.items()}
    return np.array([told.get(t, np.nan) for t in run.poses[:, 0]])


def judge(run, truth_file, sensor, limit_m, limit_share, noise_name=None):
    """Judged. OSError or ValueError: the truth cannot be read."""
    t_truth, p_truth = evaluate.load_truth(truth_file, sensor)
    q_truth = evaluate.load_truth_quaternions(truth_file, sensor)
    figures, _ = evaluate.evaluate(truth_file, run.folder, sensor)
    inside = (t_truth >= run.t[0]) & (t_truth <= run.t[-1]) if len(run.t) else np.zeros(len(t_truth), bool)
    path = float(np.linalg.norm(np.diff(p_truth[inside], axis=0), axis=1).sum())
    limit = max(limit_m, limit_share * path)
    place, error = align_run(run, t_truth, p_truth)
    truth, near = evaluate.truth_at(t_truth, p_truth, run.poses[:, 0])
    truth = np.where(near[:, None], truth, np.nan)
    if len(run.poses) and not near.any():
        raise ValueError(f'{truth_file}: none of the run\'s times lie in it: it is the truth of something else')
    R_truth = evaluate.rotation_at(t_truth, q_truth, run.poses[:, 0])
    metres, degrees = rpe(run, place, truth, R_truth)
    noise = evaluate.TRUTH_NOISE[noise_name] if noise_name else pose_consistency.TruthNoise()
    figures['flown_m'] = path
    consistency = None
    if len(run.poses):
        consistency = evaluate.judge_consistency(truth_file, run.folder, sensor, noise)
        figures.update(pose_consistency.summary(consistency))
    if run.metric:
        metric = evaluate.metric(truth_file, run.folder, sensor, noise.lag_s, None)
        figures.update({'metric_' + k: v for k, v in metric.items() if isinstance(v, (int, float))})
    step = max(1, int(inside.sum()) // MOST_WAY)
    way = np.column_stack([t_truth, p_truth])[inside][::step]
    return Judged(truth_file, limit, run.poses[:, 0], place, truth, way, error, evaluate.false_sure(place, error, limit), metres,
                  degrees, local_scale(run, place, truth), told_scale_sigma(run), consistency, figures)
