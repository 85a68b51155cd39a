"""docs/configuration.md, made from the code: each key's default and what is allowed as `godwit check --keys` says, explained as
config/godwit.toml explains it.
"""
import os
import re
import subprocess

HEAD = '''# Every key of the configuration

Made by `scripts/check_docs --build build/release --fix` from what the programs accept (`godwit check --keys`) and from the words in
`config/godwit.toml`, which is the file to begin with; a key that is left out has its default. An unknown key, a wrong type or
value refuses to start, with file, line and what is allowed: `godwit check --config FILE` tells all of it at once, with `--show` every
value.
'''
KEY = re.compile(r'^([\w.]+) = (.*?)  # (.*)$')


def told_by(program):
    """name: (default, what is allowed), in the order of the program."""
    told = subprocess.run([program, 'check', '--keys'], capture_output=True, text=True, check=True).stdout.splitlines()
    return {m.group(1): m.group(2, 3) for m in map(KEY.match, told)}


def groups(text):
    """(section, explanation, keys) in the order of config/godwit.toml; a section's own words come with no key."""
    section, words, keys = '', [], []
    for line in [*text.splitlines(), '']:
        head, key = re.match(r'\[([\w.]+)\]$', line), re.match(r'(\w+) = ', line)
        if key:
            keys.append(f'{section}.{key.group(1)}')
            continue
        if keys:
            yield section, ' '.join(words), keys
            words, keys = [], []
        if head:
            section = head.group(1)
            yield section, ' '.join(words), []
            words = []
        elif line.startswith('#'):
            words.append(line.lstrip('# '))
        elif not keys and words and not section:
            words = []  # of the file, above the first section


def cell(text):
    return text.replace('|', '\\|')


def page(root, program):
    """The whole page. ValueError: a key is in one of the two only."""
    with open(os.path.join(root, 'config/godwit.toml'), encoding='utf-8') as file:
        text = file.read()
    known, out, table, top = told_by(program), [HEAD.rstrip()], False, None
    left = dict(known)
    for section, words, keys in groups(text):
        if not keys and section.partition('.')[0] != top:
            top = section.partition('.')[0]
            out.append(f'\n## [{top}]')
            table = False
        if words:
            out.append(f'\n{words}')
            table = False
        for key in keys:
            if key not in left:
                raise ValueError(f'config/godwit.toml has {key}, which the program does not know or has told already')
            default, allowed = left.pop(key)
            if not table:
                out.append('\n| key | default | allowed |\n|---|---|---|')
                table = True
            out.append(f'| `{key}` | `{cell(default)}` | {cell(allowed)} |')
    if left:
        raise ValueError(f'config/godwit.toml lacks {", ".join(left)}')
    return '\n'.join(out) + '\n'
