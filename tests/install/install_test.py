"""Installs into an empty prefix and flies from there where neither sources nor build folder can be seen.

  install_test.py BUILD SOURCE
"""
import os
import pathlib
import subprocess
import sys
import tempfile

BUILD, SOURCE = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2])
EXPECTED = '''
bin/godwit bin/godwit-latency bin/godwitd etc/godwit/godwit.toml share/bash-completion/completions/godwit
share/bash-completion/completions/godwitd share/godwit/godwit.dbc share/godwit/models/cbam_yolov5n_320.onnx
share/godwit/models/cbam_yolov5n_416.onnx share/godwit/models/cbam_yolov5n_416.toml share/godwit/scenarios/street.toml
share/man/man1/godwit.1 share/man/man1/godwit-latency.1 share/man/man8/godwitd.8 lib/systemd/system/godwitd.service lib/udev/rules.d/80-godwit.rules
lib/systemd/network/80-godwit-can0.network lib/sysusers.d/godwit.conf
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
        for program in sorted((prefix / 'bin').iterdir()):
            for folder in (SOURCE, BUILD):
                if mentions(program, str(folder)):
                    fail(f'{program.name} names {folder}')
        for page in prefix.glob('share/man/man*/*'):
            said = run(['man', '--warnings', '-l', page], env={**os.environ, 'MAN_KEEP_STDERR': '1'}) if man() else ''
            if 'warning' in said:
                fail(f'{page.name}: {said[:400]}')
        for script in (prefix / 'share/bash-completion/completions').iterdir():
            run(['bash', '-n', script])

        # A mount namespace of its own, in which an empty folder lies over the sources; as root, or as root of a user
        # namespace.
        hidden = hide(SOURCE.resolve())
        work = pathlib.Path(temporary) / 'work'
        work.mkdir()
        script = ('mount -t tmpfs none "$1" && ! [ -e "$2" ] && cd "$3" && shift 3 && exec "$@"')
        run(['unshare', *([] if os.geteuid() == 0 else ['--map-root-user']), '--mount', 'sh', '-c', script, 'sh', hidden,
             SOURCE / 'CMakeLists.txt', work, prefix / 'bin/godwit', *FLY], cwd='/')
        if not (work / 'out/summary.json').is_file():
            fail('no summary.json')
        print(f'{len(EXPECTED)} files looked for; flown from {prefix} with {hidden} hidden')


def man():
    return subprocess.run(['which', 'man'], capture_output=True, check=False).returncode == 0


main()
