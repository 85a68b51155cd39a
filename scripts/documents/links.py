"""Links and file names of a document: what they lead to must be there, headings (#anchor) included."""
import glob
import os
import re

FOLDERS = ('benchmarks', 'config', 'detector', 'docs', 'firmware_app', 'hal', 'scripts', 'systemd', 'tests', 'toolchain', 'vo_core')


def expand(name):
    """a{b,c}d: abd, acd."""
    match = re.match(r'(.*)\{([^}]*)\}(.*)', name)
    if not match:
        return [name]
    return [match[1] + part + match[3] for part in match[2].split(',')]


def anchors(text):
    """The names by which a page's headings can be linked to, as GitHub makes them."""
    out, fenced = set(), False
    for line in text.split('\n'):
        if line.startswith('```'):
            fenced = not fenced
        heading = None if fenced else re.match(r'#{1,6} +(.*?) *#*$', line)
        if not heading:
            continue
        told = re.sub(r'\[([^\]]*)\]\([^)]*\)', r'\1', heading[1])
        name = re.sub(r'[^\w\- ]', '', told.lower()).replace(' ', '-')
        number = sum(1 for known in out if re.fullmatch(re.escape(name) + r'(-\d+)?', known))
        out.add(f'{name}-{number}' if number else name)
    return out


def wrong_links(path, text):
    here = os.path.dirname(path)
    for number, line in enumerate(text.split('\n'), 1):
        # What stands in backticks is no link.
        for target in re.findall(r'\]\(([^)\s]+)[^)]*\)', re.sub(r'`[^`]*`', '', line)):
            if '://' in target or target.startswith('mailto:'):
                continue
            file, _, anchor = target.partition('#')
            there = os.path.join(here, file) if file else path
            if not os.path.exists(there):
                yield number, f'link to {target}, which is not there'
            elif anchor and there.endswith('.md'):
                with open(there, encoding='utf-8') as page:
                    if anchor not in anchors(page.read()):
                        yield number, f'link to {target}: no heading of that page is #{anchor}'


def wrong_names(root, text):
    """Names in `backticks` that begin with a folder of the repository."""
    for number, line in enumerate(text.split('\n'), 1):
        for name in re.findall(r'`([^`]+)`', line):
            name = name.split()[0] if name.split() else ''
            if not re.match(r'(' + '|'.join(FOLDERS) + r')/[\w./*{},-]*$', name):
                continue
            for one in expand(name):
                if not glob.glob(os.path.join(root, one)) and not glob.glob(os.path.join(root, one.rstrip('/') + '*')):
                    yield number, f'`{one}` is not there'
