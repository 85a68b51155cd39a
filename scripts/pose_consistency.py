"""Does the odometry know how wrong it is? NEES and coverage of the poses in pose.csv against ground truth.

For every frame pose.csv names a reference keyframe, the camera's pose relative to it (camera to keyframe) and the
covariance of the left twist (v, w) of the inverse, T_cam_ref: T_true = exp(x) T_cam_ref, along the camera's axes. What is
judged is what one camera can know: the rotation (3 degrees of freedom) and the direction of the translation (2), seen
along the keyframe's axes, where the error is -R_ref_cam v over the length, across it. The squared error over its
covariance (NEES, Bar-Shalom et al. 2001, section 5.4) is 1 a degree of freedom where the covariance is true, and 95 % of
the errors lie inside the 95 % region.

The truth is no truth to the last digit: its own errors at both ends, white in position and rotation, and a lag of
unknown length of its positions against the pictures, and one of its rotations, common to both ends, are added with the
values given.
"""
import csv
import dataclasses

import numpy as np

MIN_AGE_S = 0.5
MIN_BASELINE = 0.02  # true baseline over median depth, above which the direction is judged
YOUNG_MAP_S = 2.0  # told apart in the summary
CHI2_95 = {2: 5.9915, 3: 7.8147, 5: 11.0705}


@dataclasses.dataclass
class TruthNoise:
    """One sigma of the truth: position [m], rotation [rad] (each axis), the lag of its positions and of its rotations [s]."""
    position_m: float = 0.0
    rotation_rad: float = 0.0
    lag_s: float = 0.0
    turn_lag_s: float = 0.0


@dataclasses.dataclass
class Judged:
    """Errors and their covariance over all frames judged; rows (rotation 3, direction 2), direction NaN where it is not.
    age: since the first pose of the frame's map [s]."""
    t: np.ndarray
    age: np.ndarray
    error: np.ndarray
    covariance: np.ndarray
    tracked: int


def skew(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def rotation_vector(R):
    """Of one rotation matrix; errors are small, so half a turn need not be told apart."""
    axis = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = np.linalg.norm(axis)
    return axis if sine < 1e-9 else axis / sine * np.arctan2(sine, (np.trace(R) - 1) / 2)


def across(d):
    """Two unit vectors across the unit vector d, 3 x 2."""
    first = np.cross(d, np.eye(3)[np.argmin(np.abs(d))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(d, first)], 1)


def matrix_of_triangle(upper):
    C = np.zeros((6, 6))
    C[np.triu_indices(6)] = upper
    return C + np.triu(C, 1).T


def error_and_covariance(estimate, truth, C, noise, velocity, rate):
    """(rotation, direction) of one frame, 5, and its covariance. Poses: (R, t) camera to world of the truth at both ends,
    (reference, camera); camera to reference of the estimate. velocity: of the truth at both ends [m/s]; rate: its turn
    rate along the camera's axes [rad/s]."""
    R, t = estimate  # ref <- cam
    (R_ref, p_ref), (R_cam, p_cam) = truth
    moved = R_ref.T @ (p_cam - p_ref)
    w = rotation_vector((R_cam.T @ R_ref) @ R)  # T_cam_ref,true = exp(w) T_cam_ref
    length, true_length = np.linalg.norm(t), np.linalg.norm(moved)
    B = across(t / length)
    direction = moved / true_length
    sine = B.T @ direction
    angle = np.arctan2(np.linalg.norm(sine), direction @ t / length)
    e_d = sine * (angle / np.linalg.norm(sine)) if np.linalg.norm(sine) > 1e-12 else sine
    J = np.zeros((5, 6))
    J[:3, 3:] = np.eye(3)
    J[3:, :3] = -B.T @ R / length
    P = J @ C @ J.T
    # The truth's: rotation error a of the reference (its axes), b of the camera (its axes), positions, lag.
    Ja, Jb, Jp = np.zeros((5, 3)), np.zeros((5, 3)), np.zeros((5, 3))
    Ja[:3], Jb[:3] = R_cam.T @ R_ref, -np.eye(3)
    Ja[3:] = B.T @ skew(direction)
    Jp[3:] = B.T @ R_ref.T / true_length
    lag = Jp @ (velocity[1] - velocity[0])
    P += noise.rotation_rad ** 2 * (Ja @ Ja.T + Jb @ Jb.T) + 2 * noise.position_m ** 2 * Jp @ Jp.T
    turn_lag = Ja @ rate[0] + Jb @ rate[1]
    P += noise.lag_s ** 2 * np.outer(lag, lag) + noise.turn_lag_s ** 2 * np.outer(turn_lag, turn_lag)
    return np.concatenate([w, e_d]), P


def judge(run, truth_at, noise=TruthNoise(), min_age_s=MIN_AGE_S):
    """Errors of all frames whose reference is old enough. truth_at(t) gives positions, rotations (camera to world),
    velocities, turn rates along the camera's axes and where the truth is near enough in time, at the times t. ValueError: pose.csv names no references."""
    with open(run / 'pose.csv') as file:
        rows = [r for r in csv.DictReader(file) if r['tracked'] == '1']
    if rows and 'ref_id' not in rows[0]:
        raise ValueError(f'{run}/pose.csv names no reference keyframes')
    judged = [r for r in rows if r['ref_id'] != '0' and float(r['t']) - float(r['ref_t']) >= min_age_s - 1e-6]
    nothing = Judged(np.zeros(0), np.zeros(0), np.zeros((0, 5)), np.zeros((0, 5, 5)), len(rows))
    if not judged:
        return nothing

    def column(*names):
        return np.array([[float(r[n]) for n in names] for r in judged])
    t, t_ref = column('t')[:, 0], column('ref_t')[:, 0]
    t_est = column('rtx', 'rty', 'rtz')
    R_est = rotation(column('rqx', 'rqy', 'rqz', 'rqw'))
    triangles = column(*(f'r{i}{j}' for i in range(6) for j in range(i, 6)))
    depth = column('median_depth')[:, 0]
    p, R, v, turn, near = truth_at(t)
    p_ref, R_ref, v_ref, turn_ref, near_ref = truth_at(t_ref)
    true_baseline = np.linalg.norm(p - p_ref, axis=1)
    baseline = np.linalg.norm(t_est, axis=1)
    # Metres a map unit, of each map.
    scale = np.ones(len(t))
    maps = column('map_id')[:, 0]
    for m in np.unique(maps):
        mine = (maps == m) & near & near_ref
        scale[maps == m] = (true_baseline[mine] @ baseline[mine]) / max(baseline[mine] @ baseline[mine], 1e-12)
    good = np.flatnonzero(near & near_ref)
    errors, covariances = np.full((len(good), 5), np.nan), np.full((len(good), 5, 5), np.nan)
    for n, i in enumerate(good):
        errors[n], covariances[n] = error_and_covariance((R_est[i], t_est[i]), ((R_ref[i], p_ref[i]), (R[i], p[i])),
                                                         matrix_of_triangle(triangles[i]), noise, (v_ref[i], v[i]),
                                                         (turn_ref[i], turn[i]))
        if not true_baseline[i] > MIN_BASELINE * scale[i] * depth[i]:
            errors[n, 3:] = np.nan
    first = {m: min(float(r['t']) for r in rows if float(r['map_id']) == m) for m in np.unique(maps)}
    age = t - np.array([first[m] for m in maps])
    return Judged(t[good], age[good], errors, covariances, len(rows))


def rotation(q):
    """Rotation matrices of quaternions x y z w, n x 4."""
    x, y, z, w = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]).transpose(2, 0, 1)


def nees(judged, rows):
    """NEES of each frame in which all of these rows are known, and which frames those are."""
    known = np.flatnonzero(np.isfinite(judged.error[:, rows]).all(1))
    e = judged.error[known][:, rows]
    P = judged.covariance[known][:, rows][:, :, rows]
    return np.einsum('ni,ni->n', e, np.linalg.solve(P, e[..., None])[..., 0]), known


def summary(judged):
    """Mean and median NEES a degree of freedom and coverage of the 95 % region: of rotation, of direction, of both."""
    out = {'judged_frames': len(judged.t), 'judged_share': len(judged.t) / max(judged.tracked, 1)}
    both, both_known = nees(judged, [0, 1, 2, 3, 4])
    rotation_only, _ = nees(judged, [0, 1, 2])
    # Where the direction is not judged the rotation counts alone.
    per_dof = rotation_only / 3
    inside = rotation_only <= CHI2_95[3]
    per_dof[both_known], inside[both_known] = both / 5, both <= CHI2_95[5]
    direction, known = nees(judged, [3, 4])
    young = judged.age < YOUNG_MAP_S
    for name, chosen in (('young_', young), ('old_', ~young)):
        if chosen.any():
            out[name + 'map_nees_per_dof'] = float(per_dof[chosen].mean())
            out[name + 'map_coverage_95'] = float(inside[chosen].mean())
    out['direction_judged_share'] = len(known) / max(judged.tracked, 1)
    for name, values, covered in (('', per_dof, inside), ('rotation_', rotation_only / 3, rotation_only <= CHI2_95[3]),
                                  ('direction_', direction / 2, direction <= CHI2_95[2])):
        if len(values):
            out[name + 'nees_per_dof'] = float(values.mean())
            out[name + 'nees_per_dof_median'] = float(np.median(values))
            out[name + 'coverage_95'] = float(covered.mean())
    return out


def plot(judged, file):
    import matplotlib
    matplotlib.use('Agg')
    import matplotlib.pyplot as plt
    fig, axes = plt.subplots(4, 2, figsize=(13, 12), constrained_layout=True)
    names = ('rotation about x', 'rotation about y', 'rotation about z', 'direction, first', 'direction, second')
    for i, (name, ax) in enumerate(zip(names, axes.flat)):
        sigma = np.sqrt(judged.covariance[:, i, i])
        ax.fill_between(judged.t, -2e3 * sigma, 2e3 * sigma, color='0.85', label='2 sigma')
        ax.plot(judged.t, 1e3 * judged.error[:, i], lw=0.7, color='C0', label='error')
        ax.set_ylim(*(np.array([-1, 1]) * 1e3 * max(4 * np.nanmedian(sigma), 3 * np.nanstd(judged.error[:, i]), 1e-9)))
        ax.set_title(name + ' [mrad]', fontsize=9)
        ax.legend(fontsize=7)
    by_time, by_age = axes[2, 1], axes[3, 0]
    for part, rows in (('rotation', [0, 1, 2]), ('direction', [3, 4])):
        values, known = nees(judged, rows)
        by_time.semilogy(judged.t[known], values / len(rows), lw=0.7, label=part)
        by_age.loglog(np.maximum(judged.age[known], 0.1), values / len(rows), '.', ms=2, label=part)
    for ax, of in ((by_time, 'over time [s]'), (by_age, "by the map's age [s]")):
        ax.axhline(1, color='k', lw=0.7)
        ax.set_title('NEES a degree of freedom ' + of, fontsize=9)
        ax.legend(fontsize=7)
    axes[3, 1].axis('off')
    fig.savefig(file, dpi=90)
