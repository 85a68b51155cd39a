"""Installs into an empty prefix and flies from there where neither sources nor build folder can be seen.

  install_test.py BUILD SOURCE
"""
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile

BUILD, SOURCE = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2])
EXPECTED = '''
bin/godwit bin/godwit-latency bin/godwitd etc/godwit/godwit.toml share/bash-completion/completions/godwit
share/bash-completion/completions/godwitd share/bash-completion/completions/godwit-latency share/godwit/godwit.dbc share/godwit/models/cbam_yolov5n_320.onnx
share/godwit/models/cbam_yolov5n_416.onnx share/godwit/models/cbam_yolov5n_416.toml share/godwit/models/yolox_nano_416.onnx
share/godwit/models/yolox_nano_416.toml share/godwit/models/yolox_nano_320.onnx share/godwit/models/LICENSE-YOLOX share/godwit/scenarios/street.toml
share/man/man1/godwit.1 share/man/man1/godwit-latency.1 share/man/man8/godwitd.8 lib/systemd/system/godwitd.service lib/udev/rules.d/80-godwit.rules
lib/systemd/network/80-godwit-can0.network lib/sysusers.d/godwit.conf bin/godwit-report bin/godwit-evaluate bin/godwit-from-kitti
bin/godwit-from-video
'''.split()
# Two frames of a simulated street, with the network: models and scenarios must both be found.
FLY = 'fly street --frames 2 --detector on --out out'.split()


def fail(reason):
    sys.exit('FAILED: ' + reason)


def run(command, **more):
    done = subprocess.run([str(word) for word in command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, **more)
    if done.returncode != 0:
        fail(f'{command} ended with {done.returncode}:\n{done.stdout}')
    return done.stdout


def hide(folder):
    """The outermost folder of `folder` that holds none of what a program needs: hidden, its content is not there."""
    needed = [pathlib.Path(p) for p in ('/usr', '/lib', '/lib64', '/proc', '/sys', '/dev', '/etc', '/bin', '/sbin')]
    needed += [pathlib.Path(tempfile.gettempdir()).resolve()]
    outermost = folder
    for parent in folder.parents:
        if parent == pathlib.Path('/') or any(parent == n or parent in n.parents or n in parent.parents for n in needed):
            break
        outermost = parent
    return outermost


def mentions(program, text):
    return text.encode() in program.read_bytes()


def main():
    with tempfile.TemporaryDirectory(prefix='godwit_install.') as temporary:
        first, prefix = pathlib.Path(temporary) / 'first', pathlib.Path(temporary) / 'moved'
        run(['cmake', '--install', BUILD, '--prefix', first, '--strip'])
        first.rename(prefix)
        missing = [name for name in EXPECTED if not (prefix / name).is_file()]
        if missing:
            fail(f'not installed: {missing}')
        for file in sorted(f for f in prefix.rglob('*') if f.is_file()):
            for folder in (SOURCE, BUILD):
                if mentions(file, str(folder)):
                    fail(f'{file.relative_to(prefix)} names {folder}')
        look_at_unit(prefix, first)
        look_at_manual(prefix)
        look_at_completion(prefix)

        hidden = hide(SOURCE.resolve())
        work = pathlib.Path(temporary) / 'work'
        work.mkdir()
        way, command = hiding(hidden, pathlib.Path(temporary) / 'empty')
        if way is None:
            skip(f'neither mounts (unshare) nor proot work here: not flown with {hidden} hidden')
        script = '! [ -e "$1" ] && cd "$2" && shift 2 && exec "$@"'
        run([*command, 'sh', '-c', script, 'sh', SOURCE / 'CMakeLists.txt', work, prefix / 'bin/godwit', *FLY], cwd='/')
        if not (work / 'out/summary.json').is_file():
            fail('no summary.json')
        run([*command, 'sh', '-c', script, 'sh', SOURCE / 'CMakeLists.txt', work, prefix / 'bin/godwit-report', 'out'], cwd='/')
        if not (work / 'out/report/report.html').is_file():
            fail('no report.html')
        for tool in ('evaluate', 'from-kitti', 'from-video'):
            said = run([*command, 'sh', '-c', script, 'sh', SOURCE / 'CMakeLists.txt', work, prefix / f'bin/godwit-{tool}', '--help'], cwd='/')
            if 'usage:' not in said:
                fail(f'godwit-{tool} --help says: {said}')
        print(f'{len(EXPECTED)} files looked for; flown from {prefix} with {hidden} hidden by {way}')


def skip(reason):
    print('SKIPPED: ' + reason)
    sys.exit(1 if os.environ.get('CI') == 'true' else 77)


def hiding(folder, empty):
    """How to run a command that finds `folder` empty: what does it, and the words before the command."""
    empty.mkdir()
    namespace = ['unshare', *([] if os.geteuid() == 0 else ['--map-root-user']), '--mount', 'sh', '-c',
                 'mount -t tmpfs none "$0" && exec "$@"', str(folder)]
    # Where mounts are refused, as in many a container: the same by ptrace.
    for way, command in (('a mount', namespace), ('proot', ['proot', '-b', f'{empty}:{folder}'])):
        if shutil.which(command[0]) is None:
            continue
        tried = subprocess.run([*command, 'ls', '-A', str(folder)], capture_output=True, text=True, check=False, cwd='/')
        if tried.returncode == 0 and not tried.stdout.strip():
            return way, command
    return None, []


def look_at_unit(prefix, installed_to):
    """The unit starts what was installed, with the configuration beside it."""
    unit = (prefix / 'lib/systemd/system/godwitd.service').read_text()
    start = re.search(r'^ExecStart=(.*)$', unit, re.M).group(1)
    wanted = f'{installed_to}/bin/godwitd --config {installed_to}/etc/godwit/godwit.toml'
    if start != wanted:
        fail(f'the unit starts "{start}" instead of "{wanted}"')


def look_at_manual(prefix):
    """man reads every page without a word, and each says all that its program's help does."""
    if shutil.which('man') is None:
        skip('man is not there (scripts/setup): the manual is not looked at')
    for page in sorted(prefix.glob('share/man/man*/*')):
        shown = subprocess.run(['man', '--warnings', '-l', str(page)], capture_output=True, text=True, check=False,
                               env={**os.environ, 'LC_ALL': 'C', 'MANWIDTH': '200', 'MAN_KEEP_STDERR': '1'})
        if shown.returncode != 0 or shown.stderr.strip():
            fail(f'man -l {page.name}: {shown.stderr[:400]}')
        for words, told in helps(prefix / 'bin' / page.stem):
            missing = [option for option in re.findall(r'^  (?:-\w,)?(--[\w-]+)', told, re.M) if option not in shown.stdout]
            if missing or words and words[0] not in shown.stdout:
                fail(f'{page.name} does not tell of {words} {missing}')


def helps(program):
    """The help of a program and of its commands: (words, text)."""
    told = run([program, '--help'])
    yield [], told
    for command in re.findall(r'^  (\w+) ', told.partition('Subcommands:')[2], re.M):
        yield [command], run([program, command, '--help'])


def look_at_completion(prefix):
    folder = prefix / 'share/bash-completion/completions'
    for script in folder.iterdir():
        run(['bash', '-n', script])
    for words, wanted in ((['godwit', 're'], {'replay', 'record'}), (['godwit', 'replay', '--pace', ''], {'max', 'real'}),
                          (['godwit', 'doctor', '--t'], {'--tilt'}), (['godwitd', '--c'], {'--config'}),
                          (['godwit-latency', '--detector', ''], {'on', 'off', 'both'})):
        script = ('. "$1"; shift; COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _${1//[^a-zA-Z0-9]/_}; '
                  'printf "%s\\n" "${COMPREPLY[@]}"')
        got = set(run(['bash', '-c', script, 'bash', folder / words[0], *words]).split())
        if got != wanted:
            fail(f'completion of {words}: {sorted(got)} instead of {sorted(wanted)}')


main()
