"""The report's pictures, drawn with matplotlib. Each function takes the runs (and what was judged of them, None without a
truth) and returns a figure, or None where there is nothing to draw."""
import matplotlib

matplotlib.use('Agg')
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402
from matplotlib.collections import LineCollection  # noqa: E402
from matplotlib.patches import Patch  # noqa: E402

from report import judgement, run_folder  # noqa: E402

# Okabe and Ito's, which the colour-blind can tell apart.
RUN_COLOURS = ('#0072B2', '#D55E00', '#009E73', '#CC79A7', '#E69F00', '#56B4E9', '#000000')
STATE_COLOURS = dict(zip(run_folder.STATES, ('#b8bec6', '#4c9f70', '#e8c547', '#ee8434', '#c1292e')))
BAD = '#c1292e'
STAGES = ('pyramid', 'apply', 'initialise', 'align', 'reproject', 'pose', 'keyframe', 'map')
DPI = 130
plt.rcParams.update({
    'font.size': 9, 'axes.spines.top': False, 'axes.spines.right': False, 'axes.edgecolor': '#8a9099', 'axes.grid': True,
    'grid.color': '#e6e8eb', 'grid.linewidth': 0.8, 'axes.axisbelow': True, 'axes.labelcolor': '#3b4048',
    'xtick.color': '#3b4048', 'ytick.color': '#3b4048', 'legend.frameon': False, 'axes.titlesize': 9.5,
    'axes.titleweight': 'bold', 'axes.titlelocation': 'left', 'figure.dpi': DPI, 'savefig.dpi': DPI,
})


def colour(n):
    return RUN_COLOURS[n % len(RUN_COLOURS)]


def unit_of(metres):
    """Factor and name of the unit in which lengths of this size are read best."""
    return (1000, 'mm') if metres < 0.01 else (100, 'cm') if metres < 1 else (1, 'm')


def gaps_as_nan(t, *values):
    """The same with a NaN where poses are missing, so that no line bridges it."""
    step = np.median(np.diff(t)) if len(t) > 1 else 0.0
    after = np.flatnonzero(np.diff(t) > 3 * step) + 1
    return [np.insert(np.asarray(v, float), after, np.nan, axis=0) for v in (t, *values)]


def error_limit(judged):
    """The upper end of the colours, common to all runs: what 99 % of the errors are below."""
    errors = [j.error[np.isfinite(j.error)] for j in judged if j is not None]
    errors = np.concatenate([e for e in errors if len(e)] or [np.array([1e-3])])
    return max(float(np.percentile(errors, 99)), 1e-4)


def trajectory(run, judged, limit):
    """From above, coloured by error; height below. limit [m]: error_limit() of all runs."""
    place = run.poses[:, 1:4] if judged is None else judged.place
    place = place[np.isfinite(place[:, 0])]
    if not len(place):
        return None
    # As high as the way is long across, so that a straight one leaves no empty picture.
    drawn = place if judged is None or not len(judged.way) else np.concatenate([place, judged.way[:, 1:]])
    high = float(np.clip(5 * np.ptp(drawn[:, 1]) / max(np.ptp(drawn[:, 0]), 1e-9), 1.7, 4.3))
    fig, (top, side) = plt.subplots(2, 1, figsize=(6.2, high + 1.9), height_ratios=(high, 1.3), constrained_layout=True)
    k, unit = unit_of(limit)
    t = run.poses[:, 0] - run.t[0]
    length = 'm' if judged is not None or run.metric else "map's unit"
    if judged is None:
        value, norm, told = t, plt.Normalize(t[0], t[-1]), 'time [s]'
        side.plot(*gaps_as_nan(t, run.poses[:, 3]), color=colour(0), lw=1.2)
    else:
        value, norm, told = k * judged.error, plt.Normalize(0, k * limit), f'error of position [{unit}]'
        grey = {'color': '#aeb4bc', 'lw': 4, 'alpha': 0.7, 'solid_capstyle': 'round'}
        t_gap, x = gaps_as_nan(t, judged.place)
        top.plot(judged.way[:, 1], judged.way[:, 2], label='truth', **grey)
        side.plot(judged.way[:, 0] - run.t[0], judged.way[:, 3], **grey)
        side.plot(t_gap, x[:, 2], color=colour(0), lw=1)
    points = np.isfinite(value)
    shown = run.poses[:, 1:4] if judged is None else judged.place
    pieces = np.stack([shown[:-1, :2], shown[1:, :2]], 1)
    whole = np.isfinite(pieces).all((1, 2)) & points[1:] & (np.diff(t) < 3 * max(np.median(np.diff(t)), 1e-9) if len(t) > 1 else True)
    if judged is None or not run.metric:
        whole &= run.poses[1:, 8] == run.poses[:-1, 8]
    lines = LineCollection(pieces[whole], array=value[1:][whole], cmap='viridis', norm=norm, lw=2.2, capstyle='round')
    top.add_collection(lines)
    top.autoscale_view()
    first = np.flatnonzero(np.isfinite(shown[:, 0]))[0]
    top.plot(*shown[first, :2], 'o', ms=7, mfc='white', mec='#22262b', mew=1.5, label='first pose', zorder=4)
    if judged is not None and judged.false_sure.any():
        wrong = judged.false_sure & np.isfinite(judged.place[:, 0])
        top.plot(*judged.place[wrong, :2].T, 'o', ms=8, mfc='none', mec=BAD, mew=1, label='false and sure', zorder=5)
    top.set_aspect('equal', 'datalim')
    top.set(xlabel=f'x [{length}]', ylabel=f'y [{length}]', title='from above' if judged is not None or run.metric else 'x and y of the first map')
    top.legend(loc='best', fontsize=8)
    fig.colorbar(lines, ax=top, label=told,  extend='neither' if judged is None else 'max')
    side.set(xlabel='time [s]', ylabel=f'z [{length}]', title='height')
    return fig


def end_of(runs):
    return max([r.t[-1] - r.t[0] for r in runs if len(r.t)] or [1.0])


def over_time(ax, runs, judged, of, k=1.0):
    """One line a run of what `of` gives of a Judged."""
    ax.set_xlim(0, end_of(runs))
    for n, (run, j) in enumerate(zip(runs, judged)):
        if j is None or not np.isfinite(of(j)).any():
            continue
        good = np.isfinite(of(j))
        ax.plot(*gaps_as_nan(j.t[good] - run.t[0], k * of(j)[good]), color=colour(n), lw=1, label=run.name)


def rpe(runs, judged):
    """RPE over a second, of each pose."""
    values = [j.rpe_m[np.isfinite(j.rpe_m)] for j in judged if j is not None]
    if not any(len(v) for v in values):
        return None
    fig, (top, bottom) = plt.subplots(2, 1, figsize=(9, 4.4), sharex=True, constrained_layout=True)
    k, unit = unit_of(max(np.percentile(v, 95) for v in values if len(v)))
    over_time(top, runs, judged, lambda j: j.rpe_m, k)
    over_time(bottom, runs, judged, lambda j: j.rpe_deg)
    for n, (run, j) in enumerate(zip(runs, judged)):
        if j is not None and 'rpe_1s_m' in j.figures and np.isfinite(j.rpe_m).any():
            rms = np.sqrt(np.nanmean(j.rpe_m ** 2)), np.sqrt(np.nanmean(j.rpe_deg ** 2))
            for ax, value in ((top, k * rms[0]), (bottom, rms[1])):
                ax.axhline(value, color=colour(n), lw=1, ls='--', alpha=0.8)
    top.set(ylabel=f'[{unit}]', title='translation over one second (dashed: root mean square)', ylim=(0, None))
    bottom.set(ylabel='[degrees]', xlabel='time [s]', title='rotation over one second', ylim=(0, None))
    if len(runs) > 1:
        top.legend(fontsize=8, ncols=3, loc='upper right')
    return fig


def latency(runs):
    """Histograms of the time a frame took and of its age, and where it went."""
    columns = [('ms', 'tracking a frame, on the wall [ms]')]
    if any('age_ms' in r.summary for r in runs):
        columns.append(('age_ms', "from the picture's time to its pose [ms]"))
    fig, axes = plt.subplots(1, len(columns) + 1, figsize=(4.2 * (len(columns) + 1), 3.4), constrained_layout=True)
    for ax, (name, title) in zip(axes, columns):
        values = [r.column(name)[r.tracked] if name in (r.frames[0] if r.frames else {}) else np.zeros(0) for r in runs]
        values = [v[np.isfinite(v)] for v in values]
        # What the thread computed stands beside it: on a busy machine the wall tells of others.
        computed = [r.column('thread_cpu_ms')[r.tracked] if name == 'ms' and r.frames and 'thread_cpu_ms' in r.frames[0] else np.zeros(0)
                    for r in runs]
        computed = [v[np.isfinite(v)] for v in computed]
        longest = max([v.max() for v in values + computed if len(v)] or [1.0])
        shortest = max(min([v.min() for v in values + computed if len(v)] or [0.1]), 0.01)
        bins = np.geomspace(shortest, max(longest, 2 * shortest), 60)
        for n, (run, v, cpu) in enumerate(zip(runs, values, computed)):
            if not len(v):
                continue
            ax.hist(v, bins, color=colour(n), alpha=0.35 if len(runs) > 1 else 0.75, histtype='stepfilled')
            if len(cpu):
                ax.hist(cpu, bins, color='#22262b' if len(runs) == 1 else colour(n), histtype='step', lw=1,
                        label="thread's processor time" if n == 0 else None)
            for key, style in (('median', '-'), ('p99', '--'), ('max', ':')):
                if name in run.summary:
                    ax.axvline(run.summary[name][key], color=colour(n), ls=style, lw=1.2, label=key if n == 0 else None)
        ax.set(xscale='log', yscale='log', xlabel=title, ylabel='frames', ylim=(0.7, None))
        ax.xaxis.set_major_formatter(matplotlib.ticker.FuncFormatter(lambda x, _: f'{x:g}'))
        if ax.get_legend_handles_labels()[0]:  # above the axes: inside, lines would cross it
            ax.legend(fontsize=8, loc='lower left', bbox_to_anchor=(-0.08, 1), ncols=4, handlelength=1.4, columnspacing=1, borderpad=0)
    stage_bars(axes[-1], runs)
    return fig


def stage_bars(ax, runs):
    height = 0.8 / len(runs)
    for n, run in enumerate(runs):
        mean = [np.nanmean(run.column(s + '_ms')[run.tracked]) if run.tracked.any() and s + '_ms' in run.frames[0] else 0.0
                for s in STAGES]
        ax.barh(np.arange(len(STAGES)) + (n + 0.5) * height - 0.4, mean, height, color=colour(n), alpha=0.8)
    ax.set_yticks(range(len(STAGES)), STAGES)
    ax.invert_yaxis()
    ax.grid(axis='y', visible=False)
    ax.set(xlabel='mean of each stage [ms]')


def timeline(runs):
    """States as a band a run, and the features behind each pose."""
    fig, axes = plt.subplots(2 * len(runs), 1, figsize=(11, 2.0 * len(runs) + 0.5), squeeze=False, sharex=True,
                             height_ratios=(1, 3.2) * len(runs), constrained_layout=True)
    for n, run in enumerate(runs):
        band, curve = axes[2 * n, 0], axes[2 * n + 1, 0]
        t = run.t - run.t[0] if len(run.t) else np.zeros(0)
        states = [f['state'] for f in run.frames]
        begins = [i for i in range(len(states)) if i == 0 or states[i] != states[i - 1]]
        for b, e in zip(begins, begins[1:] + [len(states) - 1]):
            band.axvspan(t[b], t[e], color=STATE_COLOURS.get(states[b], '#000000'), lw=0)
        for event in run.summary.get('events', []):
            if event.get('what') != 'state':
                band.plot(event['t'], 0.5, 'v', ms=4, color='#22262b')
        band.set(ylim=(0, 1), yticks=[], title=run.name if len(runs) > 1 else '')
        band.grid(False)
        band.spines['left'].set_visible(False)
        # A picture that was not flown has no features, which is another thing than none.
        flown = np.array([f['fate'] == 'processed' for f in run.frames], bool)
        seen_t, features = t[flown], run.column('features')[flown]
        curve.fill_between(seen_t, features, color=colour(n), alpha=0.25, lw=0)
        curve.plot(seen_t, features, color=colour(n), lw=0.8)
        curve.plot(t[~flown], np.zeros((~flown).sum()), '|', ms=5, color='#22262b', alpha=0.6,
                   label='not flown' if (~flown).any() else None)
        if (~flown).any():
            curve.legend(fontsize=8, loc='upper right')
        if (least := run.least_features()) is not None:
            curve.axhline(least, color=BAD, lw=0.9, ls='--')
        curve.set(ylabel='features', ylim=(0, None))
    axes[-1, 0].set_xlim(0, end_of(runs))
    axes[-1, 0].set_xlabel('time [s]')
    seen = {f['state'] for r in runs for f in r.frames}
    axes[0, 0].legend(handles=[Patch(color=c, label=s) for s, c in STATE_COLOURS.items() if s in seen], loc='lower right',
                      bbox_to_anchor=(1, 1), ncols=5, fontsize=8)
    return fig


def scale(runs, judged):
    """By how much pieces of the way came out too long, and what an inertial run says of its own scale."""
    if not any(j is not None and np.isfinite(j.local_scale).any() for j in judged):
        return None
    fig, ax = plt.subplots(figsize=(9, 2.9), constrained_layout=True)
    for n, (run, j) in enumerate(zip(runs, judged)):
        if j is None:
            continue
        known = np.isfinite(j.scale_sigma)
        if known.any():
            t, sigma = gaps_as_nan(j.t[known] - run.t[0], 100 * j.scale_sigma[known])
            ax.fill_between(t, -2 * sigma, 2 * sigma, color=colour(n), alpha=0.13, lw=0,
                            label='two sigmas told' if len(runs) == 1 else None)
    over_time(ax, runs, judged, lambda j: 100 * (j.local_scale - 1))
    ax.axhline(0, color='#3b4048', lw=0.8)
    values = np.concatenate([j.local_scale[np.isfinite(j.local_scale)] for j in judged if j is not None])
    reach = max(100 * np.percentile(np.abs(values - 1), 98) * 1.4, 0.5)
    ax.set(xlabel='time [s]', ylabel='too long [%]', ylim=(-reach, reach),
           title=f'length of the {judgement.WINDOW_S:g} s of the way around each moment, against the truth')
    if len(runs) > 1 or any(j is not None and np.isfinite(j.scale_sigma).any() for j in judged):
        ax.legend(fontsize=8, ncols=4, loc='upper right')
    return fig


def chi_square_share(x, degrees):
    """Share of a chi-square distribution of 2 or 3 degrees of freedom below x."""
    from math import erf
    x = np.asarray(x, float)
    if degrees == 2:
        return 1 - np.exp(-x / 2)
    return np.array([erf(np.sqrt(v / 2)) - np.sqrt(2 * v / np.pi) * np.exp(-v / 2) for v in x])


def consistency(runs, judged):
    """NEES over time, and how many errors lie inside the region that is told to hold a share p of them."""
    shown = [(n, r, j) for n, (r, j) in enumerate(zip(runs, judged))
             if j is not None and j.consistency is not None and len(j.consistency.t)]
    if not shown:
        return None
    fig, (left, right) = plt.subplots(1, 2, figsize=(10.5, 3.6), width_ratios=(1.9, 1), constrained_layout=True)
    for n, run, j in shown:
        for name, rows, style in (('rotation', [0, 1, 2], '-'), ('direction', [3, 4], ':')):
            values, known = judgement.pose_consistency.nees(j.consistency, rows)
            if not len(values):
                continue
            label = name if len(shown) == 1 else f'{run.name}, {name}'
            t = j.consistency.t[known] - run.t[0]
            left.plot(*gaps_as_nan(t, np.maximum(values / len(rows), 1e-3)), color=colour(n), lw=0.9, ls=style, label=label)
            inside = np.sort(chi_square_share(values, len(rows)))
            right.plot(100 * inside, 100 * np.arange(1, len(inside) + 1) / len(inside), color=colour(n), lw=1.6, ls=style)
    left.set_xlim(0, end_of(runs))
    left.axhline(1, color='#3b4048', lw=0.9)
    left.set(yscale='log', xlabel='time [s]', title='squared error over its variance, a degree of freedom (1: as told)')
    if left.get_legend_handles_labels()[0]:
        left.legend(fontsize=8, ncols=2)
    right.plot([0, 100], [0, 100], color='#3b4048', lw=0.9)
    right.set(xlim=(0, 100), ylim=(0, 100), xlabel='told [%]', ylabel='found [%]', title='errors inside the region told')
    right.set_aspect('equal')
    return fig
