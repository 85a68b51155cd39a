"""Pictures that --view wrote, made small enough for a page."""
import io
import re

import numpy as np
from PIL import Image

from report.run_folder import RunError, read

MOST = 6
WIDTH_PX = 1280
QUALITY = 85


def row_of(number, run):
    """The line of frames.csv that a picture belongs to: both are numbered from the first that was flown, wherever in the
    sequence that was. None: there is none."""
    return number if number < len(run.frames) else None


def choose(files, run):
    """At most MOST of them, of tracked frames where there are so many: spread over the flight, those after a change of
    state first of all."""
    rows = [row_of(int(f.stem), run) for f in files]
    tracked = [f for f, r in zip(files, rows) if r is not None and run.tracked[r]]
    if len(tracked) >= MOST:
        files = tracked
    if len(files) <= MOST:
        return files
    rows = np.array([row_of(int(f.stem), run) or 0 for f in files])
    states = [f['state'] for f in run.frames]
    changes = [i for i in range(1, len(states)) if states[i] != states[i - 1]]
    near = [files[i] for c in changes if (i := int(np.searchsorted(rows, c))) < len(files)][:MOST // 2]
    spread = [files[int(round(i))] for i in np.linspace(0, len(files) - 1, MOST)]
    return sorted(list(dict.fromkeys(near + spread))[:MOST], key=lambda f: int(f.stem))


def small(file, whole):
    """A JPEG, of all three views in the file or of the last, which has the others' marks as well. RunError: no picture."""
    try:
        with Image.open(file) as picture:
            picture = picture.convert('RGB')
            if not whole:
                picture = picture.crop((picture.width * 2 // 3, 0, picture.width, picture.height))
            wide = WIDTH_PX if whole else WIDTH_PX // 2
            if picture.width > wide:
                picture = picture.resize((wide, max(1, picture.height * wide // picture.width)), Image.LANCZOS)
            out = io.BytesIO()
            picture.save(out, 'JPEG', quality=QUALITY)
            return out.getvalue()
    except (OSError, SyntaxError, ValueError) as e:
        raise RunError(f'{file}: no picture: {e}') from e


def chosen(run, folder=None):
    """(JPEG bytes, caption) of some pictures of the run, the first with all three views; none where there is no folder,
    unless one was named. A named folder may be another run's: where that run lies around it, captions are of that one,
    else numbers only."""
    if folder is not None and not folder.is_dir():
        raise RunError(f'{folder}: there is no such folder of pictures')
    if folder is not None:
        try:
            run = read(folder.resolve().parent)
        except RunError:
            run = None
    folder = folder or run.folder / 'view'
    if not folder.is_dir():
        return []
    files = sorted((f for f in folder.iterdir() if re.fullmatch(r'\d+\.png', f.name)), key=lambda f: int(f.stem))
    files = choose(files, run) if run is not None else files[:MOST]
    return [(small(f, n == 0), caption(run, int(f.stem)) if run is not None else f'picture {int(f.stem)}')
            for n, f in enumerate(files)]


def caption(run, number):
    row = row_of(number, run)
    if row is None:
        return f'picture {number}'
    frame = run.frames[row]
    reason = f'; {frame["reason"]}' if frame['reason'] and not run.tracked[row] else ''
    return f'{run.t[row] - run.t[0]:.2f} s: {frame["state"]}, {frame["features"]} features{reason}'
