"""The report as one HTML page that needs no other file: pictures are in it, and there is no script."""
import base64
import html
import json

import numpy as np

from report import figures

STYLE = '''
:root { --ink: #22262b; --soft: #5d6570; --line: #dfe3e8; --back: #f6f7f9; --bad: #c1292e; --good: #2f7d4f; }
* { box-sizing: border-box; }
body { margin: 0; background: var(--back); color: var(--ink); font: 15px/1.5 system-ui, "DejaVu Sans", sans-serif; }
main { max-width: 1180px; margin: 0 auto; padding: 28px 22px 60px; }
h1 { font-size: 26px; margin: 0 0 2px; } h2 { font-size: 18px; margin: 0 0 4px; } h3 { font-size: 14px; margin: 0 0 6px; }
p.bad { color: var(--bad); margin: 0 0 12px; } p.what { color: var(--soft); margin: 0 0 12px; max-width: 80ch; }
section { background: #fff; border: 1px solid var(--line); border-radius: 8px; padding: 18px 20px; margin: 16px 0; }
.runs { display: grid; gap: 14px; grid-template-columns: repeat(auto-fit, minmax(330px, 1fr)); }
#trajectory figure { max-width: 800px; }
.seen { display: grid; gap: 12px; grid-template-columns: repeat(auto-fit, minmax(300px, 1fr)); }
.head { display: grid; gap: 10px; grid-template-columns: repeat(auto-fit, minmax(130px, 1fr)); margin: 8px 0 14px; }
.tile { border: 1px solid var(--line); border-radius: 6px; padding: 8px 12px; }
.tile b { display: block; font-size: 22px; font-weight: 650; white-space: nowrap; }
.tile span { color: var(--soft); font-size: 12.5px; }
.tile.first { border-width: 2px; } .tile.good { border-color: var(--good); } .tile.good b { color: var(--good); }
.tile.bad { border-color: var(--bad); } .tile.bad b { color: var(--bad); }
img { max-width: 100%; height: auto; display: block; }
figure { margin: 0; } figcaption { color: var(--soft); font-size: 12.5px; margin: 4px 0 12px; }
table { border-collapse: collapse; width: 100%; font-size: 13.5px; }
th, td { text-align: left; padding: 3px 14px 3px 0; border-bottom: 1px solid var(--line); vertical-align: top; }
td.n { font-variant-numeric: tabular-nums; white-space: nowrap; }
tr.group th { padding-top: 14px; border-bottom: 2px solid var(--line); }
summary { cursor: pointer; color: var(--soft); } code { font-size: 12.5px; } .scroll { overflow-x: auto; }
.dot { display: inline-block; width: 10px; height: 10px; border-radius: 5px; margin-right: 6px; }
'''
EVENTS_SHOWN = 12
WRONG_SHOWN = 10
DROPPED_SHARE = 0.02


def escape(text):
    return html.escape(str(text), quote=True)


def cell(tag, key, n, value, kind, attributes=''):
    """An element that shows a figure and carries the exact one, for whoever reads the page by a program."""
    exact = escape(json.dumps(value))
    return (f'<{tag} {attributes} data-run="{n}" data-key="{key}" data-value="{exact}">'
            f'{escape(figures.text_of(value, kind))}</{tag}>')


def picture(data, alt, caption='', mime='image/png'):
    code = base64.b64encode(data).decode('ascii')
    told = f'<figcaption>{escape(caption)}</figcaption>' if caption else ''
    return f'<figure><img src="data:{mime};base64,{code}" alt="{escape(alt)}">{told}</figure>'


def section(title, what, body, anchor):
    return f'<section id="{anchor}"><h2>{title}</h2><p class="what">{what}</p>{body}</section>' if body else ''


def heading(n, run, colour):
    s = run.summary
    how = f'{s["sequence"]} · {"threads" if s["mode"] == "threads" else "one thread"}, pace {s["pace"]} · {s["version"]}'
    return f'<h3><span class="dot" style="background:{colour}"></span>{escape(run.name)}</h3><p class="what">{escape(how)}</p>'


def tiles(n, run, judged):
    out = []
    for i, row in enumerate(figures.HEAD):
        value = figures.value_of(row.key, run, judged)
        if value is None and row.instead is not None:
            row, value = row.instead, figures.value_of(row.instead.key, run, judged)
        look = 'first ' + ('bad' if value else 'good' if value == 0 else '') if i == 0 else ''
        out.append(f'<div class="tile {look}">{cell("b", row.key, n, value, row.kind)}<span>{escape(row.told)}</span></div>')
    return f'<div class="head">{"".join(out)}</div>'


def folded(rows, head=''):
    """What is too long to be shown at once."""
    return f'<details><summary>{len(rows)} more</summary><table>{head}{"".join(rows)}</table></details>' if rows else ''


def wrong_frames(run, judged):
    """The frames that were false and sure, worst first."""
    if judged is None or not judged.false_sure.any():
        return ''
    known = [i for i in np.flatnonzero(judged.false_sure) if np.isfinite(judged.error[i])]
    known.sort(key=lambda i: -judged.error[i])
    lines = [(f'{judged.t[i] - run.t[0]:.2f} s', f'off by {figures.text_of(float(judged.error[i]), "length")}', run.poses[i, 8])
             for i in known]
    short = run.poses[judged.false_sure & ~np.isfinite(judged.error), 8]
    lines += [(figures.text_of(int((short == m).sum()), 'frames'), 'map too short to be judged', m) for m in np.unique(short)]
    rows = [f'<tr><td class="n">{when}</td><td class="n">{what}</td><td class="n">map {int(m)}</td></tr>' for when, what, m in lines]
    return f'<table>{"".join(rows[:WRONG_SHOWN])}</table>{folded(rows[WRONG_SHOWN:])}'


def dropped(run):
    """A word where the machine had no time for many of the pictures: what was tracked says little of the odometry then."""
    lost = sum(run.summary.get(key) or 0 for key in ('dropped_late', 'dropped_no_slot'))
    if lost <= DROPPED_SHARE * run.summary['frames']:
        return ''
    return f'<p class="bad">{lost} of {run.summary["frames"]} pictures were dropped: the machine was too slow, or too busy, for this pace.</p>'


def first(runs, judged, colours):
    body = ''
    for n, (run, j) in enumerate(zip(runs, judged)):
        if j is None:
            told = 'No truth is at hand: nothing can be said of errors (--truth FILE).'
        elif not len(run.poses):
            told = 'Not one frame was tracked: nothing can be false.'
        else:
            told = f'False and sure: a tracked frame whose position is off by more than {figures.text_of(j.limit_m, "length")}.'
        body += (f'<div>{heading(n, run, colours[n])}{tiles(n, run, j)}{dropped(run)}<p class="what">{escape(told)}</p>'
                 f'{wrong_frames(run, j)}</div>')
    return f'<section id="first"><div class="runs">{body}</div></section>'


def table(runs, judged, colours):
    head = ''.join(f'<th><span class="dot" style="background:{c}"></span>{escape(r.name)}</th>' for r, c in zip(runs, colours))
    body = f'<tr><th></th>{head}</tr>'
    for title, rows in figures.GROUPS:
        lines = ''
        for row in rows:
            values = [figures.value_of(row.key, r, j) for r, j in zip(runs, judged)]
            if any(v is not None for v in values):
                cells = ''.join(cell('td', row.key, n, v, row.kind, 'class="n"') for n, v in enumerate(values))
                lines += f'<tr><td>{escape(row.told)}</td>{cells}</tr>'
        if lines:
            body += f'<tr class="group"><th colspan="{len(runs) + 1}">{title}</th></tr>{lines}'
    return f'<div class="scroll"><table>{body}</table></div>'


def least_features(runs):
    least = sorted({run.least_features() for run in runs} - {None})
    return f'A frame counts as tracked with at least {" or ".join(map(str, least))} features (dashed). ' if least else ''


def event_text(e):
    """As the programs tell it (firmware_app/output/event_line.cpp)."""
    change = ' → '.join(x for x in (e.get('before'), e.get('which')) if x)
    figure = f' {e["value"]:g}' if e.get('value') or e.get('limit') else ''
    limit = f', limit {e["limit"]:g}' if e.get('limit') else ''
    return change if e.get('what') == 'state' else f'{e.get("what", "")} {change}'.strip(), f'{e.get("why", "")}{figure}{limit}'


def events(runs):
    body = ''
    for run in runs:
        rows = [f'<tr><td class="n">{e.get("t", 0):.2f} s</td><td>{escape(what)}</td><td>{escape(why)}</td></tr>'
                for e in run.summary.get('events', []) for what, why in [event_text(e)]]
        lost = run.summary.get('events_not_kept', 0)
        more = f'<p class="what">{lost} more were not kept</p>' if lost else ''
        name = f'<h3>{escape(run.name)}</h3>' if len(runs) > 1 else ''
        head = '<tr><th>time</th><th>state</th><th>reason</th></tr>'
        body += (f'<div class="scroll">{name}<table>{head}{"".join(rows[:EVENTS_SHOWN])}</table>'
                 f'{folded(rows[EVENTS_SHOWN:], head)}{more}</div>')
    return f'<div class="runs">{body}</div>'


def everything(runs):
    out = ''
    for n, run in enumerate(runs):
        rows = ''.join(f'<tr><td><code>{escape(k)}</code></td><td class="n" data-run="{n}" data-all="{escape(k)}" '
                       f'data-value="{escape(json.dumps(v))}">{escape(v if isinstance(v, str) else json.dumps(v))}</td></tr>'
                       for k, v in figures.flat(run.summary))
        out += f'<details><summary>{escape(run.name)}: all of summary.json</summary><table>{rows}</table></details>'
    return out


def write(runs, judged, colours, pictures, views, notes):
    """The whole page. pictures: {name: [PNG bytes a picture]}; views: a list a run of (JPEG bytes, caption)."""
    def shown(name, alt):
        return ''.join(picture(p, alt) for p in pictures.get(name, []))

    def side_by_side(name, alt):
        items = [picture(p, alt, run.name if len(runs) > 1 else '') for run, p in zip(runs, pictures.get(name, [])) if p]
        return f'<div class="runs">{"".join(items)}</div>' if items else ''
    seen = ''
    for run, of in zip(runs, views):
        items = [picture(data, f'what {run.name} saw', caption, 'image/jpeg') for data, caption in of]
        name = f'<h3>{escape(run.name)}</h3>' if len(runs) > 1 and items else ''
        seen += f'{name}{"".join(items[:1])}<div class="seen">{"".join(items[1:])}</div>' if items else ''
    told = ''.join(f'<p class="what">{escape(n)}</p>' for n in notes)
    title = ', '.join(r.name for r in runs)
    parts = [
        first(runs, judged, colours),
        section('The way flown', 'From above, coloured by the error of the position after alignment; the colours are the same for '
                'all runs. One camera alone does not know its scale: each of its maps is aligned with a similarity. Metric runs '
                'are moved and turned as a whole, never scaled.', side_by_side('trajectory', 'trajectory coloured by error'),
                'trajectory'),
        section('Error over one second', 'How far the motion within one second is wrong (RPE), by the time of its beginning.',
                shown('rpe', 'relative pose error over time'), 'rpe'),
        section('Scale', 'By how much pieces of the way came out too long.' +
                (' The band is what an inertial run tells of its own scale.' if any(r.metric for r in runs) else ''),
                shown('scale', 'local scale over time'), 'scale'),
        section('What the covariance says', 'Rotation and direction of translation relative to the reference keyframe. Above 1, '
                'and below the diagonal: too sure; the other way: too careful.', shown('consistency', 'consistency'), 'consistency'),
        section('States and reasons', least_features(runs) + 'Triangles are events other than a change of state.', shown('timeline', 'states over time') + events(runs), 'states'),
        section('Time', 'Of tracked frames. Both axes of the histograms are logarithmic, so that the rare and slow ones are seen. The outline is '
                'what the thread computed itself: what lies to the right of it, others had of the machine.',
                shown('latency', 'latency histogram'), 'latency'),
        section('What was seen', 'The first one whole: the picture; what was left out as moving, red; the features behind the pose '
                '(corners green, edgelets yellow, inside a mask blue).', seen, 'views'),
        section('All figures', 'Those of summary.json are taken from it; errors are those of scripts/evaluate.',
                table(runs, judged, colours) + everything(runs), 'figures'),
    ]
    return (f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
            f'<link rel="icon" href="data:,"><title>godwit: {escape(title)}</title><style>{STYLE}</style></head><body><main>'
            f'<p class="what">godwit, report of {"a run" if len(runs) == 1 else f"{len(runs)} runs"}</p><h1>{escape(title)}</h1>{told}{"".join(parts)}</main></body></html>\n')
