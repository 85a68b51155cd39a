"""`godwit top` beside a godwitd that flies: once, as JSON, without anybody there, and after a kill that left the socket.

  top_test.py GODWIT GODWITD
"""
import json
import pathlib
import signal
import subprocess
import sys
import tempfile

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent.parent))
from flying_daemon import Daemon, fail  # noqa: E402

GODWIT, GODWITD = sys.argv[1:3]


def top(*options):
    return subprocess.run([GODWIT, 'top', *options], capture_output=True, text=True, check=False, timeout=60)


def main():
    with tempfile.TemporaryDirectory(prefix='godwit_top.') as name:
        folder = pathlib.Path(name)
        config = folder / 'godwit.toml'
        config.write_text('[camera]\nsource = "sim"\nscenario = "street"\npictures = 40\n[imu]\nsource = "none"\n'
                          f'[detector]\nenabled = false\n[live]\nsocket = "{folder}/live"\n')
        nobody = top('--config', config, '--once')
        if nobody.returncode != 1 or 'no godwitd serves it' not in nobody.stderr:
            fail(f'nobody there: {nobody}')
        daemon = Daemon(GODWITD, config)
        daemon.says('-> TRACKING')
        shown = top('--config', config, '--once')
        if shown.returncode != 0 or shown.stdout.count('\n') < 12 or '\x1b' in shown.stdout:
            fail(f'{shown}')
        for words in ('state        TRACKING', 'pictures/s', 'age at pose', 'INITIALISING -> TRACKING'):
            if words not in shown.stdout:
                fail(f'"{words}": {shown.stdout}')
        piped = top('--socket', folder / 'live')
        if piped.returncode != 0 or 'state' not in piped.stdout:
            fail(f'no terminal, and it goes on: {piped}')
        told = json.loads(top('--socket', folder / 'live', '--once', '--json').stdout)
        if told['state'] != 'TRACKING' or told['pid'] != daemon.process.pid or not told['frames'] or told['quality'] is not None:
            fail(f'{told}')
        watching = subprocess.Popen([GODWIT, 'top', '--socket', folder / 'live', '--json'], stdout=subprocess.PIPE, text=True)
        lines = [json.loads(watching.stdout.readline()) for _ in range(8)]
        if not lines[0]['frames'] < lines[-1]['frames']:
            fail('it does not go on')
        daemon.process.send_signal(signal.SIGKILL)
        daemon.process.wait()
        if watching.wait(20) != 1:
            fail('whoever watches is not told of the end')
        if not (folder / 'live').exists():
            fail('the killed one took its socket along: this test proves nothing')
        daemon = Daemon(GODWITD, config)
        daemon.says('-> TRACKING')
        if top('--config', config, '--once').returncode != 0:
            fail('what the killed one left is not replaced')
        daemon.end()
        if (folder / 'live').exists():
            fail('the socket outlives an orderly end')
    print('top: ok')


main()
