"""How good are metric poses? What pose.csv holds of a run with --imu on, against ground truth, nothing scaled.

Of the run's first metric pose, heading and place are taken over (the gauge: nobody told the estimator either); from there
on positions, attitudes and what is said of their certainty are judged as they are. The covariance c00 .. c55 is of the
left twist (v, w) of T_cam_nav, so that along the navigation frame's axes the errors of place and attitude are -R v and
-R w. NEES (Bar-Shalom et al. 2001, section 5.4) is 1 a degree of freedom where the covariance is true.

ATE, scale and the vertical need no gauge: positions are aligned by rotation and translation (Umeyama, PAMI 1991, without
scale) for ATE, with scale for the scale's error; the vertical is compared in the camera's axes.
"""
import csv
import dataclasses

import numpy as np

from pose_consistency import CHI2_95, matrix_of_triangle, rotation, rotation_vector

MOVING_M_S = 0.05  # truth faster than this moves
BEGIN_S = 2.0      # the first so many seconds of metric poses are judged by themselves
WINDOW_S = 10
STILL_S = 2.0      # a rest at the end of at least this length is judged
STANDS_M_S = 0.005  # truth slower than this stands: what it does then is its own wandering


@dataclasses.dataclass
class Judged:
    """Over all metric poses with truth near: errors along the navigation frame's axes and their covariance, 6 x 6."""
    t: np.ndarray
    place: np.ndarray      # truth less estimate, gauge fixed [m]
    attitude: np.ndarray   # rotation vector [rad]
    velocity: np.ndarray   # [m/s]; NaN where none was told
    covariance: np.ndarray
    scale_sigma: np.ndarray


def read_poses(run):
    """The rows of pose.csv that hold a metric pose. ValueError: there are none such in this file."""
    with open(run / 'pose.csv') as file:
        rows = list(csv.DictReader(file))
    if rows and 'scale_sigma' not in rows[0]:
        raise ValueError(f'{run}/pose.csv has no metric poses: was it flown with --imu on?')
    return [r for r in rows if r['scale_sigma'] != '']


def numbers(rows, *names):
    return np.array([[float(r[n]) for n in names] for r in rows])


def align(source, target, with_scale):
    """s, R, t with target ~ s R source + t."""
    a, b = source - source.mean(0), target - target.mean(0)
    U, D, Vt = np.linalg.svd(b.T @ a)
    sign = np.array([1, 1, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    R = U @ np.diag(sign) @ Vt
    s = float((D * sign).sum() / (a ** 2).sum()) if with_scale else 1.0
    return s, R, target.mean(0) - s * R @ source.mean(0)


def heading_between(R_to, R_from):
    """The turn about z that comes nearest to R_to R_from^T."""
    D = R_to @ R_from.T
    angle = np.arctan2(D[1, 0] - D[0, 1], D[0, 0] + D[1, 1])
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def judge(rows, truth_at):
    """truth_at(t) gives place, rotation (camera to world, z up), velocity and where truth is near, at the times t."""
    t = numbers(rows, 't')[:, 0]
    p_truth, R_truth, v_truth, near = truth_at(t)
    rows = [r for r, n in zip(rows, near) if n]
    t, p_truth, R_truth, v_truth = t[near], p_truth[near], R_truth[near], v_truth[near]
    p, R = numbers(rows, 'tx', 'ty', 'tz'), rotation(numbers(rows, 'qx', 'qy', 'qz', 'qw'))
    C = np.array([matrix_of_triangle(c) for c in numbers(rows, *(f'c{i}{j}' for i in range(6) for j in range(i, 6)))])
    big = np.zeros((len(t), 6, 6))
    big[:, :3, :3] = big[:, 3:, 3:] = R
    C = big @ C @ big.transpose(0, 2, 1)
    gauge = heading_between(R[0], R_truth[0])
    place = (p_truth - p_truth[0]) @ gauge.T - (p - p[0])
    attitude = np.array([rotation_vector(gauge @ a @ b.T) for a, b in zip(R_truth, R)])
    velocity = v_truth @ gauge.T - numbers(rows, 'vx', 'vy', 'vz')
    judged = Judged(t, place, attitude, velocity, C, numbers(rows, 'scale_sigma')[:, 0])
    return judged, (p, R), (p_truth, R_truth, v_truth)


def nees(error, covariance):
    """A degree of freedom, for each pose."""
    return np.einsum('ni,ni->n', error, np.linalg.solve(covariance, error[..., None])[..., 0]) / error.shape[1]


def scale_error(p, p_truth):
    """By how much lengths come out too long, as a share; NaN where nothing moved."""
    if len(p) < 4 or np.ptp(p_truth, axis=0).max() < 0.02:
        return float('nan')
    return 1 / align(p, p_truth, True)[0] - 1


def rms(x):
    return float(np.sqrt((x ** 2).sum(-1).mean())) if len(x) else float('nan')


def rest_at_end(t, speed, limit=MOVING_M_S):
    """Poses of the last stretch in which truth stands; none where it is shorter than STILL_S."""
    moving = np.flatnonzero(speed > limit)
    first = moving[-1] + 1 if len(moving) else 0
    still = np.arange(first, len(t))
    return still if len(still) and t[-1] - t[still[0]] >= STILL_S else still[:0]


def summary(judged, estimate, truth, t_begin):
    """All figures of one run. t_begin: time of its first picture."""
    (p, R), (p_truth, R_truth, v_truth), t = estimate, truth, judged.t
    out = {'metric_after_s': float(t[0] - t_begin), 'metric_poses': len(t)}
    s, R_align, shift = align(p, p_truth, False)
    error = p @ R_align.T + shift - p_truth
    speed = np.linalg.norm(v_truth, axis=1)
    moving, begin = speed > MOVING_M_S, t - t[0] <= BEGIN_S
    out['path_m'] = float(np.linalg.norm(np.diff(p_truth, axis=0), axis=1).sum())
    out['ate_m'], out['ate_moving_m'] = rms(error), rms(error[moving])
    out['scale_error'], out['scale_error_begin'] = scale_error(p, p_truth), scale_error(p[begin], p_truth[begin])
    up = np.einsum('ni,ni->n', R[:, 2, :], R_truth[:, 2, :])  # world's z in the camera's axes is the last row
    tilt = np.degrees(np.arccos(np.clip(up, -1, 1)))
    out['gravity_deg'], out['gravity_begin_deg'] = float(tilt.mean()), float(tilt[begin].mean())
    out['velocity_rms_m_s'] = rms(judged.velocity)
    # The first pose is the gauge: it has no error by definition.
    e, a, C = judged.place[1:], judged.attitude[1:], judged.covariance[1:]
    if len(e):
        place, attitude = nees(e, C[:, :3, :3]), nees(a, C[:, 3:, 3:])
        out['nees_position'], out['nees_attitude'] = float(place.mean()), float(attitude.mean())
        out['coverage_95_position'] = float((3 * place <= CHI2_95[3]).mean())
        out['coverage_95_attitude'] = float((3 * attitude <= CHI2_95[3]).mean())
        # Of each ten seconds of the flight, so that many flights can be pooled: poses, and of place and attitude the sum of
        # NEES and how many poses are inside 95 %.
        number = (t[1:] - t_begin).astype(int) // WINDOW_S
        out['windows'] = [[int(w), int((number == w).sum())] + [float(x) for n in (place, attitude)
                           for x in (n[number == w].sum(), (3 * n[number == w] <= CHI2_95[3]).sum())]
                          for w in np.unique(number)]
        told = 3 * np.sqrt(np.trace(C[:, :3, :3], axis1=1, axis2=2))
        out['beyond_3_sigma_share'] = float((np.linalg.norm(e, axis=1) > told).mean())
    out['scale_sigma'] = float(judged.scale_sigma[-1])
    still = rest_at_end(t, speed)
    if len(still):
        # Against the truth: what seems to stand may yet be moved a little.
        place, turned = judged.place[still], judged.attitude[still]
        out['still_m'] = rms(place - place.mean(0))
        out['still_deg'] = float(np.degrees(rms(turned - turned.mean(0))))
    stands = rest_at_end(t, speed, STANDS_M_S)
    if len(stands):
        # By themselves: a truth that comes from sensors wanders, too.
        for name, places, rotations in (('told', p, R), ('truth', p_truth, R_truth)):
            turned = np.array([rotation_vector(rotations[stands[0]].T @ a) for a in rotations[stands]])
            out[f'stands_{name}_m'] = rms(places[stands] - places[stands].mean(0))
            out[f'stands_{name}_deg'] = float(np.degrees(rms(turned - turned.mean(0))))
    return out


def evaluate(run, truth_at):
    """Figures, and what they were computed from (None where there is no metric pose)."""
    with open(run / 'frames.csv') as file:
        frames = list(csv.DictReader(file))
    rows = read_poses(run)
    out = {'frames': len(frames)}
    if not rows or not frames:
        return {**out, 'metric_poses': 0}, None
    first = [r['t'] for r in frames].index(rows[0]['t'])
    out['tracked_share_after_metric'] = float(np.mean([f['tracked'] == '1' for f in frames[first:]]))
    maps = {r['map_id'] for r in rows}
    out['maps'] = len(maps)
    judged, estimate, truth = judge(rows, truth_at)
    if len(judged.t) < 10:
        return {**out, 'metric_poses': len(judged.t)}, None
    out.update(summary(judged, estimate, truth, float(frames[0]['t'])))
    for name in ('gyro_bias', 'accel_bias', 'mounting'):
        out[name] = [float(rows[-1][f'{name}_{axis}']) for axis in 'xyz']
    out['time_offset_s'] = float(rows[-1]['time_offset'])
    return out, judged


def plot(judged, file):
    import matplotlib
    matplotlib.use('Agg')
    import matplotlib.pyplot as plt
    fig, axes = plt.subplots(3, 3, figsize=(15, 9), constrained_layout=True)
    t = judged.t - judged.t[0]
    for i in range(3):
        for row, error, scale, unit in ((0, judged.place, 1e3, 'place {} [mm]'),
                                        (1, judged.attitude, 1e3, 'attitude {} [mrad]')):
            sigma = np.sqrt(judged.covariance[:, i + 3 * row, i + 3 * row])
            axes[row, i].fill_between(t, -2 * scale * sigma, 2 * scale * sigma, color='0.85', label='2 sigma')
            axes[row, i].plot(t, scale * error[:, i], lw=0.8, label='error')
            axes[row, i].set_title(unit.format('xyz'[i]), fontsize=9)
            axes[row, i].legend(fontsize=7)
    axes[2, 0].plot(t, judged.velocity, lw=0.7)
    axes[2, 0].set_title('velocity error [m/s]', fontsize=9)
    axes[2, 1].semilogy(t[1:], nees(judged.place[1:], judged.covariance[1:, :3, :3]), lw=0.8, label='place')
    axes[2, 1].semilogy(t[1:], nees(judged.attitude[1:], judged.covariance[1:, 3:, 3:]), lw=0.8, label='attitude')
    axes[2, 1].axhline(1, color='k', lw=0.7)
    axes[2, 1].set_title('NEES a degree of freedom', fontsize=9)
    axes[2, 1].legend(fontsize=7)
    axes[2, 2].plot(t, 100 * judged.scale_sigma)
    axes[2, 2].set_title("the scale's sigma told [%]", fontsize=9)
    fig.savefig(file, dpi=90)
