"""Commands that a document shows: the program, its command and its options must exist.

Looked at are lines of code (indented or fenced) and `backticks` that begin with a program. Options are looked for in the
sources; with the folder of a build, those of godwit, godwitd and godwit-latency in what the programs' own --help says, each
command for itself, and tests in what ctest lists. Programs of others are named in FOREIGN; of those only the name is looked
at. A command that must be left alone carries the mark in FREE on its line.
"""
import glob
import json
import os
import re
import subprocess

FREE = '<!-- not ours -->'
FOREIGN = {'apt', 'busybox', 'candump', 'docker', 'echo', 'git', 'ip', 'jetson_clocks', 'journalctl', 'modprobe', 'nvpmodel',
           'sh', 'sudo', 'sysctl', 'systemctl', 'tee', 'ulimit', 'unshare', 'v4l2-ctl'}
# Options told by themselves that other programs have.
FOREIGN_OPTIONS = {'--can-peripherals', '--list-formats-ext'}
PROGRAMS = ('godwit', 'godwitd', 'godwit-latency')
SCRIPT = re.compile(r'(\./)?((scripts|benchmarks|tests|toolchain|docs|detector)/[\w./-]+)$')


def read(path):
    with open(path, encoding='utf-8', errors='replace') as file:
        return file.read()


class Known:
    """What there is in the repository, read when it is asked for."""

    def __init__(self, root, build=None):
        self.root, self.build, self.cache = root, build, {}

    def once(self, key, make):
        if key not in self.cache:
            self.cache[key] = make()
        return self.cache[key]

    def sources(self, *patterns):
        files = [f for p in patterns for f in glob.glob(os.path.join(self.root, p), recursive=True)]
        return self.once(patterns, lambda: '\n'.join(read(f) for f in sorted(files) if os.path.isfile(f) and not f.endswith('.pyc')))

    def targets(self):
        """Names of programs that are built."""
        def make():
            cmake = self.sources('*/CMakeLists.txt', '*/*/CMakeLists.txt')
            tests = [os.path.basename(f)[:-4] for f in glob.glob(os.path.join(self.root, 'tests/*/*_test.cpp'))]
            bench = [os.path.basename(f)[:-4] for f in glob.glob(os.path.join(self.root, 'benchmarks/bench_*.cpp'))]
            return set(re.findall(r'add_executable\(([\w-]+)', cmake)) | set(tests) | set(bench) | \
                set(re.findall(r'TOGETHER (\w+)', cmake))
        return self.once('targets', make)

    def options_of_sources(self, *patterns):
        return set(re.findall(r'(?<![\w-])--?[a-zA-Z][\w-]*', self.sources(*patterns)))

    def commands(self):
        return set(re.findall(r'add_subcommand\("(\w+)"', self.sources('firmware_app/commands/*.cpp')))

    def program_options(self, program, words):
        """Options of a program's command, exactly by --help where there is a build."""
        if self.build:
            folder = 'benchmarks' if program == 'godwit-latency' else 'firmware_app'
            command = [os.path.join(self.build, folder, program), *words, '--help']

            def ask():
                try:
                    told = subprocess.run(command, capture_output=True, text=True, check=False)
                except OSError:
                    return None
                return set(re.findall(r'(?<![\w-])--?[a-zA-Z][\w-]*', told.stdout)) if told.returncode == 0 else None
            return self.once(tuple(command), ask)
        patterns = ('benchmarks/latency/*.cpp',) if program == 'godwit-latency' else ('firmware_app/**/*.cpp', 'firmware_app/**/*.h')
        table = set(re.findall(r'"(?:-\w,)?(--[\w-]+)"', self.sources(*patterns)))
        return table | {'--help', '-h', '--version'}

    def all_options(self):
        def make():
            return self.options_of_sources('scripts/**/*', 'benchmarks/*', 'tests/**/*.py', 'tests/*/run', 'docs/pictures/make',
                                           'detector/**/*.py') | self.program_options_of_sources() | FOREIGN_OPTIONS
        return self.once('all', make)

    def program_options_of_sources(self):
        return set(re.findall(r'"(?:-\w,)?(--[\w-]+)"', self.sources('firmware_app/**/*.cpp', 'firmware_app/**/*.h', 'benchmarks/**/*.cpp'))) | \
            {'--help', '--version'}

    def scenarios(self):
        return {os.path.basename(f)[:-5] for f in glob.glob(os.path.join(self.root, 'config/scenarios/*.toml'))}

    def presets(self):
        return {p['name'] for p in json.loads(read(os.path.join(self.root, 'CMakePresets.json')))['configurePresets']}


def options(words):
    """Options among the words, without values and brackets."""
    for word in words:
        match = re.match(r'\[?(--?[a-zA-Z][\w-]*)', word)
        if match:
            yield match[1]


def wrong_in_command(line, known):
    """What is wrong with one command; nothing where it is none."""
    words = line.split()
    while words and re.match(r'[A-Z_]+=\S*$', words[0]):  # variables set for it
        words = words[1:]
    if not words:
        return
    first = words[0]
    program = os.path.basename(first)
    if first.startswith('build/'):
        if program not in known.targets() and not re.search(r'[*$]', program):
            yield f'`{first}`: nothing of that name is built'
            return
    script = SCRIPT.match(first)
    if script:
        file = os.path.join(known.root, script[2])
        if not os.path.exists(file):
            yield f'`{first}` is not there'
            return
        if os.path.isfile(file) and len(words) > 1:
            yield from wrong_in_script(script[2], words[1:], known)
    elif program in PROGRAMS and re.match(r'(build/[\w/-]+/)?' + re.escape(program) + '$', first):
        yield from wrong_in_program(program, words[1:], known)
    elif first.startswith('build/release/benchmarks/'):
        table = known.options_of_sources('benchmarks/*.cpp')
        yield from (f'`{first}` has no option {o}' for o in options(words[1:]) if o not in table)
    elif first == 'ctest':
        yield from wrong_in_ctest(words[1:], known)
    elif first == 'cmake' and '--preset' in words:
        name = words[words.index('--preset') + 1]
        if name not in known.presets():
            yield f'cmake has no preset {name}'


def wrong_in_script(name, words, known):
    text = read(os.path.join(known.root, name))
    for option in options(words):
        if not re.search(r'(?<![\w-])' + re.escape(option) + r'(?![\w-])', text) and option not in ('--help', '-h'):
            yield f'`{name}` has no option {option}'
    plain = [w for w in words if re.match(r'[a-z0-9_]+$', w)]
    if name == 'scripts/test':
        steps = set(re.search(r'known="([^"]*)"', text)[1].split()) | {'full'}
        yield from (f'`scripts/test` has no step {w}' for w in plain if w not in steps)
    if name == 'tests/vm/run':
        cases = {os.path.basename(f) for f in glob.glob(os.path.join(known.root, 'tests/vm/cases/*'))}
        yield from (f'`tests/vm/run` has no case {w}' for w in plain if w not in cases)
    if '--scenarios' in words:
        for scenario in words[words.index('--scenarios') + 1].split(','):
            if re.match(r'[a-z]', scenario) and scenario not in known.scenarios():
                yield f'there is no scenario {scenario}'


def wrong_in_program(program, words, known):
    command = []
    if program == 'godwit':
        while words and re.match(r'[a-z]+$', words[0]) and words[0] in known.commands():
            command.append(words.pop(0))
        if not command and words and re.match(r'[a-z]+$', words[0]):
            yield f'`godwit` has no command {words[0]}'
            return
        if command in (['fly'], ['sim']) and words and re.match(r'[a-z][\w-]*$', words[0]) and words[0] not in known.scenarios():
            yield f'there is no scenario {words[0]}'
    table = known.program_options(program, command)
    if table is None:
        yield f'`{" ".join([program, *command])} --help` fails'
        return
    yield from (f'`{" ".join([program, *command])}` has no option {o}' for o in options(words) if o not in table)


def wrong_in_ctest(words, known):
    if '-R' not in words or not known.build:
        return
    wanted = words[words.index('-R') + 1].strip('\'"')
    told = known.once(('ctest', wanted), lambda: subprocess.run(
        ['ctest', '--test-dir', known.build, '-N', '-R', wanted], capture_output=True, text=True, check=False).stdout)
    if not re.search(r'Total Tests: [1-9]', told):
        yield f'ctest knows no test {wanted}'


def pieces(line):
    """The commands of one line: without its comment, split where a shell would begin another one."""
    line = re.split(r' {2,}[#(]', line)[0].split(' # ')[0].rstrip('\\')
    return [p.strip() for p in re.split(r';|&&| \| ', line) if p.strip()]


def is_command(text):
    """Whether it begins as a command does."""
    words = [w for w in text.split() if not re.match(r'[A-Z_]+=\S*$', w)]
    first = words[0] if words else ''
    return bool(SCRIPT.match(first) or first.startswith('build/') or first in PROGRAMS or first in ('ctest', 'cmake')
                or os.path.basename(first) in FOREIGN)


def shown(text):
    """(line, command) of each command that a document shows, but for those on a line with the mark."""
    for number, line, in_code in lines_of(text):
        if FREE in line:
            continue
        told = [line.strip()] if in_code else re.findall(r'`([^`]+)`', line)
        # In a sentence one word is a name; links.py looks at those.
        yield from ((number, p) for t in told for p in pieces(t) if is_command(p) and (in_code or ' ' in p))


def lines_of(text):
    """(number, line, whether it is code) of a document."""
    fenced, before_blank, in_code = False, True, False
    for number, line in enumerate(text.split('\n'), 1):
        if line.startswith('```'):
            fenced = not fenced
        else:
            in_code = fenced or line.startswith('    ') and (before_blank or in_code)
            yield number, line, in_code
        before_blank = not line.strip() or line.startswith('#') and not fenced


def wrong_commands(text, known):
    for number, command in shown(text):
        yield from ((number, what) for what in wrong_in_command(command, known))
    for number, line, in_code in lines_of(text):
        if not in_code:
            for told in re.findall(r'`(--[a-z][^`]*)`', line):
                yield from ((number, f'no program here has an option {o}') for o in options(told.split()) if o not in known.all_options())
