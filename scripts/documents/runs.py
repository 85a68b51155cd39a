"""Commands that a document shows are run by a test, or marked here with the reason why not.

A test runs a command where one of its files, or scripts/test, names the program (of godwit the program's command, too) and each
option that is shown. What is a test itself (ctest, a program below tests/) is its own. Programs of others are not looked at.
"""
import glob
import os
import re

from documents.commands import FOREIGN, PROGRAMS, SCRIPT, options, read, shown

# What no test runs as it is shown: a program, or a program and an option; and why.
BARS = 'wants two idle processors and twelve minutes; what is written of it: service_bars_test.py'
NOT_RUN = {
    'godwit-init-survey': 'a survey without a bar to hold, some ten seconds a sequence; what it starts: initializer_test.cpp',
    'benchmarks/service_bars --input': BARS,
    'benchmarks/service_bars --json': BARS,
    'benchmarks/service_bars --seconds': BARS,
    'scripts/check_docs --fix': 'writes into the repository; what it writes: check_docs_test.py',
    'scripts/package --generic': 'an hour of the compiler for other processors; without the option: scripts/test packages',
}
# This check's own test names programs as examples.
NO_EVIDENCE = ('tests/scripts/check_docs_test.py',)
RUNNERS = ('scripts/test', 'scripts/package', '.ci/run')


class Tests:
    """The text of all tests, and of what runs them, file by file."""

    def __init__(self, root):
        self.files = {}
        self.found = {}  # what naming() found: documents name the same few programs hundreds of times
        for path in glob.glob(os.path.join(root, 'tests/**/*'), recursive=True) + [os.path.join(root, f) for f in RUNNERS]:
            name = os.path.relpath(path, root)
            if os.path.isfile(path) and name not in NO_EVIDENCE and os.path.splitext(name)[1] in ('', '.py', '.sh', '.cpp', '.h', '.txt'):
                self.files[name] = read(path)

    def naming(self, pattern, but=''):
        if (pattern, but) not in self.found:
            self.found[pattern, but] = [text for name, text in self.files.items() if name != but and re.search(pattern, text)]
        return self.found[pattern, but]


def head_of(words):
    """(what is run, a pattern by which a test names it, the words behind it), or None for what needs no test or is another's."""
    first = words[0]
    program = os.path.basename(first)
    script = SCRIPT.match(first)
    if script:
        folder, name = os.path.split(script[2])
        if script[2].startswith('tests/') and re.search(r'\.py$|_test$', name):
            return script[2], rf'(?<![\w-]){re.escape(name)}(?![\w-])', words[1:]
        quoted = "['\"]"
        return script[2], (rf'{re.escape(folder)}/{re.escape(name)}(?![\w-])|'
                           rf'{quoted}{re.escape(folder)}{quoted} / {quoted}{re.escape(name)}{quoted}'), words[1:]
    if first.startswith('build/') and '/tests/' in first or first == 'ctest':
        return None
    if first == 'cmake':
        if '--preset' not in words:
            return (f'cmake {words[1]}', rf'(?<![\w-]){re.escape(words[1])}(?![\w-])', []) if words[1] in ('--install', '--build') else None
        preset = words[words.index('--preset') + 1]
        return f'cmake --preset {preset}', rf'(?<![\w-]){re.escape(preset)}(?![\w-])', []
    if program == 'godwit':
        sub = next((w for w in words[1:2] if re.match(r'[a-z]+$', w)), '')
        rest = words[2:] if sub else words[1:]
        if sub == 'calibrate' and rest and rest[0] in ('camera', 'imu'):
            sub, rest = f'calibrate {rest[0]}', rest[1:]
        # As a word of its own in a list, at the beginning of a string, or behind the program's name.
        named = rf'["\'](?:calibrate )?{sub.split()[-1]}[ "\']|' if sub else ''
        return f'godwit {sub}'.strip(), rf'{named}(?i:\bgodwit(?:_tool)?)["\'}} ]* {sub or "--"}', rest
    if program in PROGRAMS or first.startswith('build/') and '/benchmarks/' in first:
        return program, rf'(?<![\w-]){re.escape(program)}(?![\w-])', words[1:]
    return None


def not_run(command, tests):
    """The keys into NOT_RUN of what of a command no test runs."""
    words = command.split()
    while words and re.match(r'[A-Z_]+=\S*$', words[0]):
        words = words[1:]
    if not words or os.path.basename(words[0]) in FOREIGN:
        return
    head = head_of(words)
    if not head:
        return
    name, pattern, rest = head
    own = [tests.files[name]] if name in tests.files and name.startswith('tests/') else []
    known = tests.naming(pattern, but=name)
    if not known:
        yield name
        return
    for option in options(rest):
        if not any(re.search(rf'(?<![\w-]){re.escape(option)}(?![\w-])', text) for text in known + own):
            yield f'{name} {option}'


def wrong_runs(text, tests):
    for number, command in shown(text):
        for key in not_run(command, tests):
            if key not in NOT_RUN:
                yield number, f'no test runs `{key}`, and scripts/documents/runs.py does not say why'


def wrong_marks(texts, tests):
    """Marks in vain: of what is run by now, or shown by no document."""
    needed = {key for text in texts for _, command in shown(text) for key in not_run(command, tests)}
    yield from (f'`{key}` is marked in vain: a test runs it, or no document shows it' for key in NOT_RUN if key not in needed)
