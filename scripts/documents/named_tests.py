"""docs/hazards.md: each hazard and each fault found has a number, the numbers of a table count, and each row names a test that
exists; with the folder of a build, one that ctest runs."""
import glob
import os
import re
import subprocess

from documents.commands import read

TITLES = ('| # | failure |', '| # | what happened |')


class Tests:
    """What tests there are: gtest's suites and names, and files."""

    def __init__(self, root, build=None):
        self.root, self.run = root, None
        if build:
            self.run = subprocess.run(['ctest', '--test-dir', build, '-N'], capture_output=True, text=True, check=False).stdout
            # Of a Python test the command is told, too: its name in ctest is another.
            self.run += read(os.path.join(build, 'CTestTestfile.cmake'))
            self.run += '\n'.join(read(f) for f in glob.glob(os.path.join(build, 'tests/**/CTestTestfile.cmake'), recursive=True))
        text = '\n'.join(read(f) for f in glob.glob(os.path.join(root, 'tests/**/*.cpp'), recursive=True))
        found = re.findall(r'TEST(?:_F|_P)?\(\s*(\w+),\s*(\w+)\)', text)
        self.suites, self.names = {s for s, _ in found}, {n for _, n in found}
        self.pairs = {f'{s}.{n}' for s, n in found}

    def is_run(self, name):
        return self.run is None or re.search(rf'(?<!\w){re.escape(name)}(?!\w)', self.run) is not None

    def file(self, name):
        return (glob.glob(os.path.join(self.root, 'tests/**', name), recursive=True) or [None])[0]

    def wrong_in(self, cell):
        """(names found, what is wrong) of a cell like 'PoseHold; link_test.py lost, new_map; ARedCameraIsTold'."""
        good, wrong = 0, []
        for part in re.split(r'[;,]', re.sub(r'[`()]', ' ', cell)):
            words = part.split()
            for i, word in enumerate(words):
                if re.fullmatch(r'\w+_test\.(py|cpp)', word):
                    file = self.file(word)
                    missing = [w for w in words[i + 1:] if file and not re.search(rf'\b{w}\b', read(file))]
                    wrong += [f'{word} is not in tests/'] if not file else [f'{word} knows no {w}' for w in missing]
                    if file and word.endswith('.py') and not self.is_run(word):
                        wrong.append(f'ctest does not run {word}')
                    good += bool(file) and not missing
                    break
                if word.startswith('tests/'):
                    missing = not os.path.exists(os.path.join(self.root, word))
                    cases = [w for w in words[i + 1:] if not os.path.exists(os.path.join(self.root, 'tests/vm/cases', w))]
                    wrong += [f'{word} is not there'] if missing else [f'{word} has no case {w}' for w in cases]
                    good += not missing and not cases
                    break
                if re.search(r'[a-z][A-Z]', word) and re.fullmatch(r'[A-Z][\w.]*', word):
                    known = word in self.pairs or word in self.names or word in self.suites
                    wrong += [] if known else [f'no test is called {word}']
                    if known and not self.is_run(word.split('.')[-1]):
                        wrong.append(f'ctest does not run {word}')
                    good += known
        return good, wrong


def wrong_rows(root, text, build=None):
    tests, number, rows = Tests(root, build), 0, 0
    inside = False
    for line_number, line in enumerate(text.split('\n'), 1):
        if line.startswith(TITLES):
            inside, number = True, 0
            continue
        if not line.startswith('|'):
            inside = False
        if not inside or re.match(r'\|[-|: ]+$', line):
            continue
        number, rows = number + 1, rows + 1
        cells = [c.strip() for c in re.split(r'(?<!\\)\|', line)[1:-1]]
        if cells[0] != str(number):
            yield line_number, f'row {number} has the number {cells[0]}'
        good, wrong = tests.wrong_in(cells[-1])
        yield from ((line_number, w) for w in wrong)
        if not good:
            yield line_number, f'row {number} names no test'
    if not rows:
        yield 1, f'no table of hazards (it begins with "{TITLES[0]}")'
